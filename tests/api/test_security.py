"""The threats in docs/security.md: each row has a test, or a reason why it has none."""

import base64
import re
import socket
import stat
import subprocess
import sys
from importlib.metadata import version
from pathlib import Path

import httpx2
import psutil
import pytest

from api.page import routers as page_routers
from tests.service import free_port, start_service

pytestmark = pytest.mark.ray
ROOT = Path(__file__).parents[2]
TOKEN, ROBOT = "u" * 32, "r" * 32
PROXY = "127.0.0.2"
RUN = {"task": "arm", "method": "prior", "preset": "smoke"}
XSS = "<script>alert(1)</script>"


@pytest.fixture(scope="module")
def guarded(tmp_path_factory):
    """A service with tokens, few live runs and a low rate, in a folder that was open to all."""
    folder = tmp_path_factory.mktemp("guarded")
    folder.chmod(0o755)
    (folder / "adr.sqlite").touch()  # it is the service's own
    environment = {
        "ADR_TOKEN": TOKEN,
        "ADR_ROBOT_TOKEN": ROBOT,
        "ADR_RATE": "600/hour",  # more than the tests send by themselves, however fast
        "ADR_MAX_LIVE_RUNS": "3",
        "ADR_PROXIES": PROXY,
    }
    with start_service(folder, cpus=1, environment=environment) as running:
        yield running


@pytest.fixture
def http(guarded):
    with httpx2.Client(base_url=guarded.client.url, timeout=60) as client:
        yield client


def bearer(token):
    return {"Authorization": f"Bearer {token}"}


def test_the_table_names_a_test_or_a_reason_for_every_threat():
    table = (ROOT / "docs/security.md").read_text()
    rows = [line.split("|")[1:-1] for line in table.splitlines() if line.startswith("| ")]
    assert len(rows) > 11
    assert rows[0][0].strip() == "threat"
    here = "\n".join(path.read_text() for path in (ROOT / "tests").rglob("test_*.py"))
    for threat, _, shown in rows[1:]:
        tests = re.findall(r"`(test_\w+)`", shown)
        assert tests or "no test:" in shown, threat
        for name in tests:
            assert f"def {name}(" in here, name


def test_nothing_is_open_without_the_token_but_the_health_check(http, guarded):
    assert http.get("/healthz").status_code == 200
    routes = httpx2.get(f"{guarded.client.url}/openapi.json", headers=bearer(TOKEN)).json()["paths"]
    pages = [route.path for router in page_routers for route in router.routes]
    assert http.get("/static/style.css").status_code == 200
    for path in [*routes, *pages, "/openapi.json"]:
        if path not in ("/healthz", "/login"):
            refused = http.get(path)
            assert refused.status_code == 401, path
            assert refused.headers["WWW-Authenticate"].startswith("Bearer")


@pytest.mark.parametrize("path", ["/static/%2e%2e/guard.py", "/static/..%2fguard.py"])
def test_static_files_do_not_lead_out_of_their_folder(guarded, path):
    """Sent as it is: clients tidy such paths up."""
    address = guarded.client.url.removeprefix("http://")
    host, _, port = address.partition(":")
    with socket.create_connection((host, int(port)), timeout=30) as connection:
        request = f"GET {path} HTTP/1.1\r\nHost: {address}\r\nConnection: close\r\n\r\n"
        connection.sendall(request.encode())
        answer = b"".join(iter(lambda: connection.recv(65536), b""))
    assert answer.startswith((b"HTTP/1.1 404", b"HTTP/1.1 401"))
    assert b"class Guard" not in answer


def test_a_robots_token_opens_its_tasks_and_nothing_else(http):
    assert http.get("/v1/target_tasks", headers=bearer(ROBOT)).status_code == 200
    claim = {"worker": "r", "tasks": ["arm"]}
    assert http.post("/v1/target_tasks/claim", json=claim, headers=bearer(ROBOT)).status_code == 204
    for method, path in (
        ("GET", "/v1/runs"),
        ("POST", "/v1/runs"),
        ("GET", "/"),
        ("GET", "/metrics"),
    ):
        assert http.request(method, path, headers=bearer(ROBOT)).status_code == 403


def test_a_browser_reads_by_password_and_cannot_be_made_to_write(http):
    password = base64.b64encode(f"anyone:{TOKEN}".encode()).decode()
    basic = {"Authorization": f"Basic {password}"}
    assert http.get("/", headers=basic).status_code == 200
    assert http.post("/v1/runs", json=RUN, headers=basic).status_code == 401
    for wrong in ("Basic !!!", "Basic", "Bearer", f"Bearer {TOKEN}x", f"Digest {TOKEN}"):
        assert http.get("/", headers={"Authorization": wrong}).status_code == 401


@pytest.mark.parametrize("path", ["/v1/runs/run_0/cancel", "/v1/benchmarks/bench_0/resume"])
@pytest.mark.parametrize("origin", ["https://attacker.example", "null", "http://127.0.0.1:1"])
def test_a_page_elsewhere_cannot_change_anything_even_without_a_body(http, path, origin):
    """A browser sends such a request for any page, and no token may be needed."""
    refused = http.post(path, headers={**bearer(TOKEN), "Origin": origin})
    assert refused.status_code == 403
    assert refused.json()["type"] == "/problems/foreign_origin"
    ours = str(http.base_url).rstrip("/")
    assert http.post(path, headers={**bearer(TOKEN), "Origin": ours}).status_code == 404
    assert http.get("/v1/runs", headers={**bearer(TOKEN), "Origin": origin}).status_code == 200


@pytest.mark.parametrize("text", ["a\x1b[2Jb", "a\nb", "a\u202eb", "\x9b31m"])
def test_text_of_a_robot_cannot_control_a_terminal(http, text):
    claim = {"worker": text, "tasks": ["arm"]}
    answer = http.post("/v1/target_tasks/claim", json=claim, headers=bearer(ROBOT))
    assert answer.status_code == 422
    failure = {"lease": "x", "message": text}
    answer = http.post("/v1/target_tasks/task_0/fail", json=failure, headers=bearer(ROBOT))
    assert answer.status_code == (404 if text == "a\nb" else 422)


def test_a_name_that_is_not_the_services_is_refused(http):
    refused = http.get("/healthz", headers={"Host": "attacker.example"})
    assert refused.status_code == 400
    assert "not a name of this service" in refused.json()["detail"]
    assert http.get("/healthz", headers={"Host": "localhost:1"}).status_code == 200


def test_browsers_load_and_run_nothing_but_our_own_files(http):
    for path in ("/", "/docs", "/v1/runs", "/nothing"):
        headers = http.get(path, headers=bearer(TOKEN)).headers
        assert headers["Content-Security-Policy"].startswith("default-src 'none'")
        assert headers["X-Content-Type-Options"] == "nosniff"
        assert "Access-Control-Allow-Origin" not in headers
        assert "unsafe-inline" not in headers["Content-Security-Policy"].split("style-src")[0]
    pages = "".join(http.get(p, headers=bearer(TOKEN)).text for p in ("/", "/docs", "/submit"))
    assert set(re.findall(r"<script[^>]*>", pages)) <= {
        f'<script src="/static/{name}" defer>' for name in ("vendor/htmx.min.js", "page.js")
    }
    assert not re.search(r"\son\w+=|javascript:", pages)
    assert not re.search(r"(src=|<link[^>]*href=)\"(https?:)?//", pages)


def test_a_browser_logs_in_by_the_token_and_its_cookie_serves_our_own_pages_alone(http):
    asked = http.get("/robots", headers={"Accept": "text/html"})
    assert asked.status_code == 401
    assert 'name="token"' in asked.text
    assert 'name="next" value="/robots"' in asked.text
    assert "WWW-Authenticate" not in asked.headers  # it would show a window of its own
    wrong = http.post("/login", data={"token": "x" * 32})
    assert (wrong.status_code, "Set-Cookie" in wrong.headers) == (401, False)
    ours = str(http.base_url).rstrip("/")
    for given, then in (("/robots", "/robots"), ("//elsewhere.example", "/"), ("https://a.b", "/")):
        entered = http.post("/login", data={"token": TOKEN, "next": given})
        assert (entered.status_code, entered.headers["Location"]) == (303, then)
    assert {"HttpOnly", "SameSite=strict"} <= set(entered.headers["Set-Cookie"].split("; "))
    assert http.get("/").status_code == 200
    assert "Log out" in http.get("/").text
    (cookie,) = http.cookies.values()
    assert TOKEN not in cookie
    with httpx2.Client(base_url=ours) as other:
        assert other.get("/", headers=bearer(cookie)).status_code == 401
    assert http.post("/runs/run_0/cancel", headers={"Origin": ours}).status_code == 404
    elsewhere = {"Origin": "https://attacker.example"}
    assert http.post("/runs/run_0/cancel", headers=elsewhere).status_code == 403
    http.post("/logout")
    assert http.get("/").status_code == 401


def test_names_that_are_markup_are_shown_and_not_run(http):
    refused = http.get(f"/benchmarks/{XSS}", headers=bearer(TOKEN))
    assert refused.headers["Content-Type"].startswith("application/problem+json")
    for path in (f"/v1/runs?task={XSS}", f"/v1/runs/{XSS}"):
        assert "json" in http.get(path, headers=bearer(TOKEN)).headers["Content-Type"]


def test_code_does_not_come_in_by_a_spec(http):
    for given in (
        {**RUN, "task": "os:system"},
        {**RUN, "runtime_env": {"pip": ["evil"]}},
        {**RUN, "method": {"name": "prior", "entrypoint": "os:system"}},
        {**RUN, "target": {"kind": "external", "env": "os:system"}},
        {**RUN, "model": "<mujoco><include file='/etc/passwd'/></mujoco>"},
    ):
        assert http.post("/v1/runs", json=given, headers=bearer(TOKEN)).status_code == 422
    xml = {**bearer(TOKEN), "Content-Type": "application/xml"}
    assert http.post("/v1/datasets", content=b"<mujoco/>", headers=xml).status_code in (400, 415)


def test_paths_do_not_lead_to_files(http):
    for path in ("..%2f..%2fray_token", "%2e%2e/ray_token", "ray_token", "/etc/passwd"):
        for place in ("/v1/artifacts/", "/v1/criticisms/x/", "/v1/datasets/"):
            answer = http.get(place + path, headers=bearer(TOKEN))
            assert answer.status_code == 404


def test_headers_without_end_are_not_waited_for(guarded):
    host, port = guarded.client.url.removeprefix("http://").split(":")
    with socket.create_connection((host, int(port)), timeout=60) as connection:
        connection.sendall(b"GET /healthz HTTP/1.1\r\nHost: localhost\r\nX: " + b"x" * 20_000)
        assert connection.recv(100).startswith(b"HTTP/1.1 400 ")


def test_more_requests_than_the_rate_wait(http, guarded):
    transport = httpx2.HTTPTransport(local_address="127.0.0.2")  # the other tests keep theirs
    with httpx2.Client(base_url=guarded.client.url, timeout=60, transport=transport) as other:
        answers = (other.get("/healthz") for _ in range(1_201))  # the hour may end once
        refused = next(answer for answer in answers if answer.status_code == 429)
    assert 0 < int(refused.headers["Retry-After"]) <= 3600
    assert refused.headers["Content-Type"] == "application/problem+json"
    assert http.get("/healthz").status_code == 200


def test_more_runs_than_may_wait_are_refused(http):
    long = {**RUN, "training": {"max_steps": 10_000_000, "stop_at_threshold": False}}
    made = [
        http.post("/v1/runs", json={**long, "seed": seed}, headers=bearer(TOKEN))
        for seed in range(5)
    ]
    assert [answer.status_code for answer in made] == [202, 202, 202, 429, 429]
    assert made[-1].headers["Retry-After"]
    assert "ADR_MAX_LIVE_RUNS" in made[-1].json()["detail"]
    grid = {"tasks": ["arm"], "methods": ["dropo"], "preset": "smoke"}
    assert http.post("/v1/benchmarks", json=grid, headers=bearer(TOKEN)).status_code == 429
    for answer in made[:3]:
        http.post(f"/v1/runs/{answer.json()['id']}/cancel", headers=bearer(TOKEN))


@pytest.mark.parametrize(("address", "is_believed"), [("127.0.0.1", False), (PROXY, True)])
def test_a_trusted_proxy_alone_says_who_its_client_is(guarded, address, is_believed):
    client_of_it = "192.0.2.77" if is_believed else "192.0.2.78"
    headers = {"X-Forwarded-For": client_of_it, "X-Forwarded-Proto": "https"}
    transport = httpx2.HTTPTransport(local_address=address)
    with httpx2.Client(base_url=guarded.client.url, transport=transport) as proxy:
        entered = proxy.post("/login", data={"token": TOKEN}, headers=headers)
    assert entered.status_code == 303
    assert ("Secure" in entered.headers["Set-Cookie"]) == is_believed
    assert (client_of_it in guarded.log.read_text()) == is_believed


def test_secrets_are_in_no_log_and_no_answer(http, guarded):
    http.get("/v1/runs", headers=bearer("w" * 32))
    shown = guarded.log.read_text() + http.get("/metrics", headers=bearer(TOKEN)).text
    ray_token = (guarded.data_dir / "ray_token").read_text()
    for secret in (TOKEN, ROBOT, "w" * 32, ray_token):
        assert secret not in shown


def test_the_folder_is_the_owners_alone(guarded):
    assert stat.S_IMODE(guarded.data_dir.stat().st_mode) == 0o700
    assert "was open to others (mode 755)" in guarded.log.read_text()
    assert stat.S_IMODE((guarded.data_dir / "ray_token").stat().st_mode) == 0o600


def test_ray_asks_for_a_token_and_is_new_enough(service):
    assert tuple(map(int, version("ray").split(".")[:2])) >= (2, 54)
    jobs = service.client.ready()["dashboard"] + "/api/jobs/"
    assert httpx2.get(jobs).status_code == 401
    known = {"Authorization": f"Bearer {(service.data_dir / 'ray_token').read_text()}"}
    assert httpx2.get(jobs, headers=known).status_code == 200


def processes_of(running):
    return [psutil.Process(pid) for pid in (running.process.pid, *running.children)]


def test_nobody_else_reaches_the_sockets_and_tokens_of_ray(service):
    """Another user had put his own in the place of the raylet's."""
    paths = {
        Path(connection.laddr)
        for process in processes_of(service)
        for connection in process.net_connections("unix")
        if str(connection.laddr).startswith("/")
    }
    files = [path for path in service.data_dir.rglob("*") if path.is_file()]
    token = (service.data_dir / "ray_token").read_bytes()
    paths |= {path for path in files if token in path.read_bytes()}
    assert len(paths) > 3
    for path in paths:
        above = [stat.S_IMODE(parent.stat().st_mode) for parent in path.parents]
        assert 0o700 in above, path


def test_every_port_that_listens_on_all_interfaces_is_named_in_the_docs(service):
    documented = (ROOT / "docs/security.md").read_text()
    names = {
        "gcs_server": "GCS",
        "raylet": "raylet",
        "DashboardAgent": "dashboard agent",
        "RuntimeEnvAgent": "runtime environment agent",
        "dashboard.py": "dashboard's metrics",
        "monitor.py": "autoscaler's monitor",
        "ray::": "workers",
        "api serve": "service's own",
    }
    for process in processes_of(service):
        title = " ".join(process.cmdline())
        for connection in process.net_connections("tcp"):
            if connection.status == "LISTEN" and not connection.laddr.ip.startswith("127."):
                name = next(name for key, name in names.items() if key in title)
                assert name in documented, (title, connection.laddr)


@pytest.mark.parametrize("how", ["a file in its place", "read-only"])
def test_a_data_folder_that_cannot_be_written_is_reported_without_a_traceback(tmp_path, how):
    folder = tmp_path / "data"
    if how == "read-only":
        folder.mkdir()
        mounted = ["mount", "--bind", "-o", "ro", str(folder), str(folder)]
        if subprocess.run(["unshare", "--mount", "true"], check=False).returncode:
            pytest.skip("mounts cannot be made here")
        script = f"{' '.join(mounted)} && mount -o remount,ro,bind {folder} && exec "
    else:
        folder.write_text("")
        script = "exec "
    serve = f"{sys.executable} -m api serve --no-dashboard --port {free_port()} --data-dir {folder}"
    command = ["sh", "-c", script + serve]
    if how == "read-only":
        command = ["unshare", "--mount", *command]
    ended = subprocess.run(
        command, capture_output=True, text=True, check=False, timeout=60, cwd=ROOT
    )
    assert ended.returncode != 0
    assert "there can be no data in" in ended.stderr
    assert "Traceback" not in ended.stderr


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"ADR_HOST": "0.0.0.0"}, "refusing to listen"),  # noqa: S104
        ({"ADR_HOST": "192.0.2.7", "ADR_TOKEN": "short"}, "16 characters or more"),
        ({"ADR_ROBOT_TOKEN": ROBOT}, "has no effect without ADR_TOKEN"),
        ({"ADR_RATE": "many"}, "is no rate"),
    ],
)
def test_it_does_not_start_open_by_mistake(tmp_path, given, message):
    command = [sys.executable, "-m", "api", "serve", "--data-dir", str(tmp_path)]
    environment = {"PATH": "/usr/bin:/bin", "HOME": str(tmp_path), **given}
    ended = subprocess.run(
        command, env=environment, capture_output=True, text=True, check=False, timeout=60, cwd=ROOT
    )
    assert ended.returncode == 2
    assert message in ended.stderr.replace("\n", " ")
