"""The demo: the whole service, from nothing to a figure, on the small task."""

import os
import socket
import subprocess
import sys
import time
from collections.abc import Generator
from contextlib import contextmanager
from pathlib import Path

from rich.console import Console

from adr_service.errors import AdrError
from api.client import AdrClient, Unreachable
from api.display import live, results_table

BENCHMARK = {
    "tasks": ["arm"],
    "methods": ["udr", "simopt", "dropo"],
    "seeds": [0, 1, 2],
    "preset": "demo",
}
_START_TIMEOUT_S = 120.0


class ServiceDidNotStart(AdrError):
    """The demo's service ended or hung before it was ready."""

    code = "service_did_not_start"


def tell(console: Console, data_dir: Path, port: int) -> int:
    """Start a service, run `BENCHMARK` on it over REST, show what came out; 0 if all went well."""
    port = port or _free_port()
    console.print(f"Starting the service on http://127.0.0.1:{port} (data in {data_dir}) …")
    with _service(data_dir, port) as client:
        benchmark = client.submit_benchmark(BENCHMARK)
        console.print(f"Watch it in a browser: {client.url}{benchmark['links']['page']}")
        console.print(
            "An arm must lift its hand to a mark. How heavy its links are and how much its joints "
            "rub is unknown;\nmethods infer that from trajectories of the target, and policies are "
            "trained on what they infer.\n"
        )
        final = live(console, client, benchmark["id"])
        results = client.results(benchmark["id"])
        console.print(results_table(results))
        failures = [run for run in final["runs"] if run["state"] != "succeeded"]
        for run in failures:
            why = run["error"]["message"] if run["error"] else run["state"]
            console.print(f"{run['spec']['method']['name']} did not succeed: {why}")
        if failures:
            return 1
        for name in ("returns.png", "parameters.png"):
            figure = data_dir / name
            figure.write_bytes(client.figure(benchmark["id"], name))
            console.print(f"figure: {figure}")
        (data_dir / "results.csv").write_text(client.results_csv(benchmark["id"]))
        console.print(f"table:  {data_dir / 'results.csv'}")
    console.print(
        f"The results stay in {data_dir}. To look at them again: adr serve --data-dir {data_dir}, "
        f"then http://127.0.0.1:8000{benchmark['links']['page']}"
    )
    return 0


@contextmanager
def _service(data_dir: Path, port: int) -> Generator[AdrClient]:
    """A service of our own in another process, stopped when the block ends."""
    data_dir.mkdir(parents=True, exist_ok=True, mode=0o700)
    log_path = data_dir / "service.log"
    command = [
        sys.executable,
        "-m",
        "api",
        "serve",
        "--port",
        str(port),
        "--data-dir",
        str(data_dir),
    ]
    with log_path.open("w") as log:
        process = subprocess.Popen(command, stdout=log, stderr=subprocess.STDOUT)  # noqa: S603 - our own command
    try:
        with AdrClient(f"http://127.0.0.1:{port}", os.environ.get("ADR_TOKEN", "")) as client:
            _wait_until_ready(client, process, log_path)
            yield client
    finally:
        process.terminate()
        process.wait(timeout=60)


def _wait_until_ready(client: AdrClient, process: subprocess.Popen[bytes], log_path: Path) -> None:
    deadline = time.monotonic() + _START_TIMEOUT_S
    while time.monotonic() < deadline and process.poll() is None:
        try:
            client.ready()
        except Unreachable:
            time.sleep(0.2)
        else:
            return
    tail = "\n".join(log_path.read_text().splitlines()[-5:])
    raise ServiceDidNotStart(f"the service did not start; the end of {log_path}:\n{tail}")


def _free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])
