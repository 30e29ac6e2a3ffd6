"""A service of one's own in another process, for as long as a block."""

import os
import subprocess
import sys
import time
from collections.abc import Generator
from contextlib import contextmanager
from pathlib import Path

from adr_service.client import AdrClient, Unreachable, connect
from adr_service.errors import AdrError
from api.cli.ports import check_port

_START_TIMEOUT_S, _END_TIMEOUT_S = 120.0, 60.0
_SHARED = ("DATABASE_URL", "RAY_ADDRESS", "MAX_CORES", "RESOURCE", "HOST")  # of ADR_…


class ServiceDidNotStart(AdrError):
    """The service ended or hung before it was ready."""

    code = "service_did_not_start"


@contextmanager
def own_service(data_dir: Path, port: int) -> Generator[AdrClient]:
    """A client of a service that runs in another process until the block ends."""
    check_port("127.0.0.1", port)
    for folder in (*reversed(data_dir.parents), data_dir):  # each for nobody else to read
        folder.mkdir(exist_ok=True, mode=0o700)
    log_path = data_dir / "service.log"
    command = [sys.executable, "-P", "-m", "api", "serve"]  # -P: not an api of this folder
    command += ["--port", str(port), "--data-dir", str(data_dir)]
    with log_path.open("w") as log:
        # a Ctrl-C is ours to handle: the service may still be asked for what it has
        process = subprocess.Popen(  # noqa: S603 - our own command
            command, stdout=log, stderr=subprocess.STDOUT, start_new_session=True, env=_own()
        )
    try:
        with connect(f"http://127.0.0.1:{port}") as client:
            _wait_until_ready(client, process, log_path)
            yield client
    finally:
        process.terminate()
        try:
            process.wait(_END_TIMEOUT_S)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()


def _own() -> dict[str, str]:
    """The environment without what names another database, cluster or address."""
    shared = {f"ADR_{name}" for name in _SHARED} | {"RAY_ADDRESS"}
    return {name: value for name, value in os.environ.items() if name.upper() not in shared}


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
