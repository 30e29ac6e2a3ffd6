"""The service over HTTP, as a user meets it: a real process with Ray and SQLite."""

import csv
import io
import json
import re
import sqlite3
import stat
import subprocess
import sys
import time
from contextlib import closing
from pathlib import Path

import httpx2
import pytest

from adr_service.tasks.catalogue import BUILT_IN
from adr_service.training.policy import Policy
from api.client import AdrClient, Refused, Unreachable
from tests.recordings import recording
from tests.service import RunningService, until, wait_until_finished

pytestmark = pytest.mark.ray
SMOKE = {"task": "arm", "method": "simopt", "preset": "smoke"}


@pytest.fixture(scope="module")
def http(service: RunningService):
    with httpx2.Client(base_url=service.client.url, timeout=60) as client:
        yield client


@pytest.fixture(scope="module")
def finished(service: RunningService):
    """A SimOpt run that has succeeded."""
    run = service.client.submit_run(SMOKE)
    assert wait_until_finished(service.client, run["id"], 120)["state"] == "succeeded"
    return run["id"]


@pytest.fixture(scope="module")
def benchmark(service: RunningService):
    spec = {"tasks": ["arm"], "methods": ["dropo"], "seeds": [0], "preset": "smoke"}
    submitted = service.client.submit_benchmark(spec)
    assert wait_until_finished(service.client, submitted["id"], 120)["states"] == {"succeeded": 3}
    return submitted["id"]


@pytest.fixture(scope="module")
def content():
    return recording("arm", 100, [1.2, 0.6, 2.0, 1.0]).to_npz()


@pytest.fixture(scope="module")
def uploaded(service: RunningService, content):
    return service.client.upload(content, "arm")


class TestRuns:
    def test_submitting_is_accepted_and_says_where_to_look(self, http):
        response = http.post("/v1/runs", json={**SMOKE, "method": "prior"})
        assert response.status_code == 202
        assert http.get(response.headers["Location"]).json()["id"] == response.json()["id"]

    def test_a_finished_run_has_its_story_results_and_policy(self, service, http, finished):
        events = http.get(f"/v1/runs/{finished}/events").json()["items"]
        assert [e["seq"] for e in events] == list(range(1, len(events) + 1))
        assert events[0]["event"]["type"] == "run_queued"
        assert events[-1]["event"]["type"] == "run_succeeded"
        rows = service.client.results(finished)["rows"]
        assert [row["target_transitions"] for row in rows] == [0, 20]
        assert "mean nothing" in service.client.results(finished)["note"]
        policy = Policy.from_bytes(service.client.policy(finished))
        assert policy.action_low.tolist() == [-1, -1]

    def test_it_has_the_learning_curves_of_its_policies(self, http, finished):
        trainings = http.get(f"/v1/runs/{finished}/trainings").json()
        assert [[point["steps"] for point in t["curve"]] for t in trainings] == [[300, 600]] * 2
        assert all(training["is_finished"] for training in trainings)
        content = http.get(trainings[0]["links"]["policy"]).content
        assert Policy.from_bytes(content).action_low.tolist() == [-1, -1]

    def test_a_training_that_was_stopped_leaves_its_curve_and_its_best_policy(self, service, http):
        long = {**SMOKE, "method": "prior", "seed": 78}
        long["training"] = {"max_steps": 1_000_000, "evaluate_every": 600}
        id = service.client.submit_run(long)["id"]
        while not (trainings := http.get(f"/v1/runs/{id}/trainings").json()):
            time.sleep(0.2)
        service.client.cancel(id)
        assert wait_until_finished(service.client, id, 60)["state"] == "cancelled"
        (training,) = http.get(f"/v1/runs/{id}/trainings").json()
        assert training["curve"][: len(trainings[0]["curve"])] == trainings[0]["curve"]
        assert not training["is_finished"]
        policy = Policy.from_bytes(http.get(training["links"]["policy"]).content)
        assert policy.action_low.tolist() == [-1, -1]

    def test_it_says_what_it_cost(self, service, finished):
        cost = service.client.cost(finished)
        kinds = {kind["kind"]: kind for kind in cost["kinds"]}
        assert kinds.keys() == {"train_policy", "target_rollout", "infer", "evaluate"}
        assert kinds["train_policy"]["stages"] == 2
        for kind in kinds.values():
            assert 0 < kind["cpu_seconds"] < 2 * kind["seconds"]
            assert kind["preparing_seconds"] < kind["seconds"]

    def test_events_are_paged(self, http, finished):
        whole = http.get(f"/v1/runs/{finished}/events").json()["items"]
        first = http.get(f"/v1/runs/{finished}/events?limit=2").json()
        rest = http.get(f"/v1/runs/{finished}/events?after={first['next_page_token']}").json()
        assert first["items"] + rest["items"] == whole

    def test_runs_are_listed_by_filter_and_page(self, service, http, finished):
        every = service.client.list_all("runs", page_size="1")
        assert finished in {run["id"] for run in every}
        found = http.get("/v1/runs", params={"method": "simopt", "state": "succeeded"}).json()
        assert {run["spec"]["method"]["name"] for run in found["items"]} == {"simopt"}

    def test_a_dry_run_tells_the_cost_and_starts_nothing(self, service, http):
        before = len(service.client.list_all("runs"))
        answer = http.post("/v1/runs?validate_only=true", json=SMOKE)
        assert answer.status_code == 200
        body = answer.json()
        assert body["plan"]["trainings"] == 2
        assert body["plan"]["cores"] == 2
        assert body["spec"]["training"]["max_steps"] == 600
        assert len(service.client.list_all("runs")) == before

    def test_a_run_is_cancelled_resumed_and_deleted(self, service, http):
        long = {**SMOKE, "seed": 77, "training": {"max_steps": 20_000, "evaluate_every": 20_000}}
        id = service.client.submit_run(long)["id"]
        assert http.delete(f"/v1/runs/{id}").status_code == 409
        service.client.cancel(id)
        assert wait_until_finished(service.client, id, 60)["state"] == "cancelled"
        assert http.post(f"/v1/runs/{id}/resume").status_code == 202
        assert service.client.get(id)["submission"] == 2
        assert http.post(f"/v1/runs/{id}/resume").status_code == 409
        service.client.cancel(id)
        wait_until_finished(service.client, id, 60)
        assert http.delete(f"/v1/runs/{id}").status_code == 204
        assert http.get(f"/v1/runs/{id}").status_code == 404


class TestBenchmarks:
    def test_results_come_as_json_csv_and_figures(self, service, http, benchmark):
        rows = service.client.results(benchmark)["rows"]
        assert [row["method"] for row in rows] == ["dropo", "dropo", "prior", "oracle"]
        table = list(csv.DictReader(io.StringIO(service.client.results_csv(benchmark))))
        assert [float(r["normalised_return"]) for r in table] == [
            row["normalised_return"] for row in rows
        ]
        names = service.client.figures(benchmark)
        assert names == ["returns", "parameters", "spread", "cost"]
        for name in names:
            assert service.client.figure(benchmark, f"{name}.png").startswith(b"\x89PNG")
            assert b"<svg" in service.client.figure(benchmark, f"{name}.svg")
        drawn = csv.DictReader(io.StringIO(service.client.figure(benchmark, "cost.csv").decode()))
        assert all(float(row["inference_seconds"]) > 0 for row in drawn)

    def test_the_page_shows_them(self, http, benchmark):
        page = http.get(f"/benchmarks/{benchmark}").text
        assert "dropo" in page
        for name in ("returns.svg", "spread.png", "cost.csv"):
            assert f"/v1/benchmarks/{benchmark}/figures/{name}" in page
        assert "these numbers mean nothing" in page
        assert benchmark in http.get("/").text

    def test_seeds_are_added_to_a_finished_one_and_nothing_is_computed_twice(self, service):
        spec = {"tasks": ["arm"], "methods": ["droid"], "seeds": [0], "preset": "smoke"}
        id = service.client.submit_benchmark(spec)["id"]
        wait_until_finished(service.client, id, 120)
        before = service.client.results(id)["rows"]
        started = service.started_stages
        service.client.extend_benchmark(id, {"methods": ["udr"]})
        assert wait_until_finished(service.client, id, 120)["states"] == {"succeeded": 4}
        after = service.client.results(id)["rows"]
        assert [row for row in after if row["method"] != "udr"] == before
        new = service.started_stages[len(started) :]
        assert len(new) == 4  # two trainings, two evaluations
        assert not set(new) & set(started)
        with pytest.raises(Refused, match="must not repeat"):
            service.client.extend_benchmark(id, {"seeds": [0]})
        with pytest.raises(Refused, match="nothing to add"):
            service.client.extend_benchmark(id, {})

    def test_the_papers_claims_are_held_against_what_there_is(self, service, benchmark):
        assert service.client.claims(benchmark) == []  # smoke runs mean nothing
        assert service.client.claims() == []

    def test_a_benchmark_is_cancelled_and_deleted(self, service, http):
        spec = {"tasks": ["arm"], "methods": ["udr"], "seeds": [5, 6], "preset": "smoke"}
        training = {"max_steps": 50_000, "evaluate_every": 50_000}
        id = service.client.submit_benchmark({**spec, "training": training})["id"]
        assert http.delete(f"/v1/benchmarks/{id}").status_code == 409
        service.client.cancel(id)
        assert wait_until_finished(service.client, id, 60)["states"] == {"cancelled": 6}
        service.client.cancel(id)
        service.client.delete(id)
        assert http.get(f"/v1/benchmarks/{id}").status_code == 404

    def test_a_dry_run_counts_shared_trainings_once(self, http):
        spec = {"tasks": ["arm"], "methods": ["udr", "simopt", "dropo"], "seeds": [0, 1]}
        body = http.post("/v1/benchmarks?validate_only=true", json={**spec, "preset": "smoke"})
        # per seed: prior, oracle, 2 of UDR, 1 of SimOpt, 1 of DROPO
        assert body.json()["plan"]["trainings"] == 12


class TestRecordings:
    """An offline method learns from an uploaded recording, with no target at all."""

    def test_an_upload_is_stored_once_and_comes_back(self, service, http, content, uploaded):
        headers = {"Content-Type": "application/octet-stream"}
        again = http.post("/v1/datasets", content=content, headers=headers)
        assert (again.status_code, again.json()) == (200, uploaded)
        assert http.get(again.headers["Location"]).json() == uploaded
        assert http.get(uploaded["links"]["content"]).content == content
        assert uploaded["id"] in {data["id"] for data in service.client.list_all("datasets")}

    def test_a_run_gives_a_distribution_and_a_policy(self, service, http, uploaded):
        target = {"kind": "recorded", "dataset": uploaded["id"]}
        method = {"name": "sysid", "iterations": 50}
        run = service.client.submit_run({**SMOKE, "method": method, "target": target})
        assert wait_until_finished(service.client, run["id"], 120)["state"] == "succeeded"
        found = service.client.distribution(run["id"])
        means = {p["name"]: p["mean"][0] for p in found["parameters"]}
        assert means == pytest.approx(
            {"upper_mass": 1.2, "fore_mass": 0.6, "shoulder_friction": 2.0, "elbow_friction": 1.0},
            rel=1e-6,  # there is no noise
        )
        assert Policy.from_bytes(service.client.policy(run["id"])).action_low.tolist() == [-1, -1]
        results = service.client.results(run["id"])
        assert results["rows"] == []
        assert {e["truth"] for e in results["estimates"]} == {None}
        assert service.client.figures(run["id"]) == ["parameters", "cost"]
        kinds = [
            e["event"]["kind"]
            for e in service.client.get_events(run["id"])
            if e["event"]["type"] == "stage_finished"
        ]
        assert kinds == ["infer", "train_policy"]
        with pytest.raises(Refused, match=f"{run['id']} learns from"):
            service.client.delete(uploaded["id"])

    @pytest.mark.parametrize(
        ("changes", "message"),
        [
            ({"dataset": "data_0"}, "there is no dataset 'data_0'"),
            ({"episodes": 9}, "has 1 episodes; asked for the first 9"),
            ({"kind": "robot"}, "'simulated', 'recorded'"),
        ],
    )
    def test_what_cannot_be_learned_from_is_refused(self, service, uploaded, changes, message):
        target = {"kind": "recorded", "dataset": uploaded["id"], **changes}
        with pytest.raises(Refused, match=message):
            service.client.submit_run({**SMOKE, "method": "droid", "target": target})

    def test_a_recording_of_another_robot_is_refused(self, service, content, uploaded):
        with pytest.raises(Refused, match="hopper measures 11 and takes 3"):
            service.client.upload(content, "hopper")
        target = {"kind": "recorded", "dataset": uploaded["id"]}
        with pytest.raises(Refused, match="hopper measures 11 and takes 3"):
            service.client.submit_run(
                {"task": "hopper", "method": "droid", "preset": "smoke", "target": target}
            )

    def test_methods_that_visit_the_target_are_refused(self, service, uploaded):
        target = {"kind": "recorded", "dataset": uploaded["id"]}
        with pytest.raises(Refused, match="serves droid, dropo, sysid"):
            service.client.submit_run({**SMOKE, "target": target})

    def test_an_upload_that_is_none_is_refused(self, service, http):
        with pytest.raises(Refused, match="not a readable"):
            service.client.upload(b"nothing")
        large = http.post("/v1/datasets", content=b"x" * 64_000_001)
        assert large.status_code == 413


class TestBadInput:
    """422 with what was given and what is accepted; nothing is stored."""

    @pytest.mark.parametrize(
        ("body", "given", "accepted"),
        [
            ({**SMOKE, "method": "magic"}, "magic", "udr, bayrn, simopt"),
            ({**SMOKE, "task": "hoper"}, "hoper", "arm, hopper"),
            ({**SMOKE, "variant": "windy"}, "windy", "vanilla, noisy, unmodeled"),
            ({**SMOKE, "iterations": -1}, "-1", "greater than or equal to 1"),
            ({**SMOKE, "seed": "0"}, "'0'", "valid integer"),
            ({**SMOKE, "sed": 0}, "sed", "did you mean 'seed'"),
            ({**SMOKE, "method": {"name": "dropo", "budget": -5}}, "-5", "greater than"),
            ([], "[]", "dictionary"),
            ({}, "nothing", "Field required"),
        ],
        ids=str,
    )
    def test_it_is_refused(self, service, http, body, given, accepted):
        self.refused(service, http, json.dumps(body), given, accepted)

    @pytest.mark.parametrize("number", ["NaN", "Infinity", "1e999"])
    def test_numbers_that_are_none_are_refused(self, service, http, number):
        body = json.dumps(SMOKE)[:-1] + f', "training": {{"gamma": {number}}}}}'
        self.refused(service, http, body, "nan" if number == "NaN" else "inf", "finite")

    def test_broken_json_is_refused(self, service, http):
        self.refused(service, http, '{"task": ', "", "JSON")

    def test_a_bad_benchmark_stores_no_run(self, service, http):
        body = json.dumps({"tasks": ["arm", "leg"], "methods": ["udr"], "preset": "smoke"})
        self.refused(service, http, body, "leg", "arm, hopper", path="/v1/benchmarks")

    def refused(self, service, http, body, given, accepted, path="/v1/runs"):
        before = len(service.client.list_all("runs"))
        headers = {"Content-Type": "application/json"}
        response = http.post(path, content=body, headers=headers)
        assert response.status_code == 422
        assert response.headers["Content-Type"] == "application/problem+json"
        (first, *_) = response.json()["errors"]
        assert given in first["given"] + first["detail"]
        assert accepted in first["detail"]
        assert len(service.client.list_all("runs")) == before

    @pytest.mark.parametrize(
        "path",
        [
            "/v1/runs/run_x",
            "/v1/runs/run_x/events",
            "/v1/runs/run_x/policy",
            "/v1/benchmarks/bench_x",
            "/v1/benchmarks/bench_x/results",
            "/v1/artifacts/abc",
            "/benchmarks/bench_x",
            "/nowhere",
        ],
    )
    def test_what_is_not_there_is_a_404_problem(self, http, path):
        response = http.get(path)
        assert response.status_code == 404
        assert response.headers["Content-Type"] == "application/problem+json"

    def test_an_unknown_figure_is_refused_with_the_list(self, http, finished):
        response = http.get(f"/v1/runs/{finished}/figures/curve.svg")
        assert response.status_code == 404
        assert "returns, collection, parameters" in response.json()["detail"]

    def test_a_body_of_megabytes_is_refused(self, http):
        response = http.post("/v1/runs", content=b"[" + b"1," * 1_000_000 + b"1]")
        assert response.status_code == 413


class TestService:
    def test_it_says_that_it_is_well(self, http):
        assert http.get("/healthz").json() == {"status": "ok"}
        ready = http.get("/readyz").json()
        assert ready["status"] == "ready"
        assert ready["cores"] == 2

    def test_while_another_process_holds_the_database_nothing_is_lost(self, http, service):
        """Longer than writers wait."""
        run = service.client.submit_run({**SMOKE, "method": "prior", "seed": 71})["id"]
        with closing(
            sqlite3.connect(service.data_dir / "adr.sqlite", isolation_level=None)
        ) as other:
            other.execute("begin immediate")
            refused = http.get("/readyz")
            assert (refused.status_code, refused.json()["title"]) == (503, "database unavailable")
            assert int(refused.headers["Retry-After"]) > 0
            assert http.get(f"/v1/runs/{run}").json()["state"] in ("queued", "running")
        assert http.get("/readyz").json()["status"] == "ready"
        assert wait_until_finished(service.client, run, 120)["state"] == "succeeded"

    def test_its_numbers_are_there_for_prometheus(self, http, finished):
        answer = http.get("/metrics")
        assert answer.headers["Content-Type"].startswith("text/plain; version=0.0.4")
        numbers = dict(
            line.rsplit(" ", 1) for line in answer.text.splitlines() if not line.startswith("#")
        )
        assert float(numbers['adr_runs{state="succeeded"}']) >= 1
        assert float(numbers['adr_stages_stored{kind="train_policy"}']) >= 1
        assert float(numbers['adr_target_tasks{of="simulated",state="done"}']) >= 1
        assert float(numbers["adr_cores"]) == 2
        assert float(numbers["adr_disk_free_bytes"]) > 0

    def test_the_same_key_makes_one_run(self, http):
        key, body = {"Idempotency-Key": "once"}, {**SMOKE, "method": "prior", "seed": 77}
        first, again = (http.post("/v1/runs", json=body, headers=key) for _ in range(2))
        assert (first.status_code, again.status_code) == (202, 202)
        assert first.json()["id"] == again.json()["id"]
        other = http.post("/v1/runs", json={**body, "seed": 78}, headers=key)
        assert other.status_code == 422
        assert "came with another request before" in other.json()["detail"]

    def test_what_has_not_changed_is_not_sent_again(self, http, finished):
        first = http.get(f"/v1/runs/{finished}/results")
        tag = first.headers["ETag"]
        same = http.get(f"/v1/runs/{finished}/results", headers={"If-None-Match": f'"x", W/{tag}'})
        assert (same.status_code, same.content, same.headers["ETag"]) == (304, b"", tag)
        other = http.get(f"/v1/runs/{finished}/results", headers={"If-None-Match": '"x"'})
        assert other.content == first.content

    def test_a_run_can_be_waited_for_and_followed(self, service, http):
        run = service.client.submit_run({**SMOKE, "method": "prior", "seed": 79})["id"]
        state = "queued"
        while state not in ("succeeded", "failed"):
            state = http.get(f"/v1/runs/{run}", params={"wait": 20}).json()["state"]
        lines = http.get(f"/v1/runs/{run}/events/stream").text.splitlines()
        ids = [int(line[3:]) for line in lines if line.startswith("id:")]
        assert ids == list(range(1, len(ids) + 1))
        assert [line for line in lines if line.startswith("event:")][-1].split()[1] == "end"
        rest = http.get(f"/v1/runs/{run}/events/stream", headers={"Last-Event-ID": "2"}).text
        assert [line for line in rest.splitlines() if line.startswith("id:")] == [
            f"id: {i}" for i in ids[2:]
        ]

    def test_the_page_of_a_run_tells_its_story(self, http, finished):
        page = http.get(f"/runs/{finished}").text
        assert "iteration_finished" in page
        assert f"/v1/runs/{finished}/figures/returns.svg" in page
        assert f'href="/runs/{finished}"' in http.get("/").text
        assert http.get("/runs/run_0").status_code == 404

    def test_a_stage_in_the_works_is_linked_to_its_process_in_rays_dashboard(self, service, http):
        # there until it is cancelled
        training = {"max_steps": 1_000_000, "stop_at_threshold": False}
        long = {**SMOKE, "method": "prior", "seed": 80, "training": training}
        run = service.client.submit_run(long)["id"]
        link = re.compile(r'href="(http://\S+)/#/actors/\w{32}">adr:run_\w+:trainer:\d+<')
        found = until(lambda: link.search(http.get(f"/runs/{run}").text))
        assert found.group(1) == http.get("/readyz").json()["dashboard"]
        http.post(f"/v1/runs/{run}/cancel")

    def test_the_log_has_a_line_of_every_stage_with_its_ids(self, service, finished):
        lines = [line for line in service.log.read_text().splitlines() if "stage begun" in line]
        assert any(f"run={finished} " in line and "kind=infer " in line for line in lines)

    def test_a_second_service_on_the_same_data_says_why_it_does_not_start(self, service):
        command = [sys.executable, "-m", "api", "serve", "--port", "0", "--data-dir"]
        given = [*command, str(service.data_dir)]
        done = subprocess.run(given, capture_output=True, text=True, timeout=60, check=False)
        assert done.returncode != 0
        assert "is in use by another service; stop it, or give this one another" in done.stderr
        assert "Traceback" not in done.stderr

    def test_the_dashboard_shows_what_there_is(self, http):
        shown = (Path(__file__).parents[1] / "docs/monitoring/dashboard.json").read_text()
        asked = set(re.findall(r"\badr_\w+", shown))
        assert asked == set(re.findall(r"^# TYPE (adr_\w+)", http.get("/metrics").text, re.M))

    def test_the_catalogue_lists_tasks_methods_and_presets(self, http):
        assert {task["name"] for task in http.get("/v1/tasks").json()} == set(BUILT_IN)
        assert "DropoSettings" in json.dumps(http.get("/v1/methods").json())
        assert list(http.get("/v1/presets").json()) == ["smoke", "demo", "quick", "paper"]

    def test_tasks_do_not_tell_the_truth(self, http):
        """What simulated targets hide is nowhere in the catalogue."""
        assert "3.534" not in http.get("/v1/tasks").text

    def test_secrets_are_for_the_owner_alone(self, service):
        mode = (service.data_dir / "ray_token").stat().st_mode
        assert stat.S_IMODE(mode) == 0o600
        token = (service.data_dir / "ray_token").read_text()
        assert token not in service.log.read_text()

    def test_it_listens_for_everyone_only_with_a_token(self, tmp_path):
        command = [sys.executable, "-m", "api", "serve", "--host", "0.0.0.0"]  # noqa: S104
        done = subprocess.run(
            command, capture_output=True, text=True, timeout=60, cwd=tmp_path, check=False
        )
        assert done.returncode == 2
        assert "set ADR_TOKEN" in done.stderr

    def test_the_client_explains_a_refusal_and_an_absence(self, service):
        with pytest.raises(Refused, match="did you mean 'arm'"):
            service.client.submit_run({**SMOKE, "task": "arn"})
        with (
            AdrClient("http://127.0.0.1:9") as nobody,
            pytest.raises(Unreachable, match="adr serve"),
        ):
            nobody.ready()
