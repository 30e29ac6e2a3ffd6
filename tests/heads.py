"""A Ray head and its nodes on this machine, in processes of their own, which a test may kill.

with start_head(environment, nodes=2) as head:       # whose autoscaler may add two
    start_service(..., environment={"ADR_RAY_ADDRESS": head.address})
"""

import json
import os
import subprocess
import sys
from collections.abc import Generator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

import psutil
from ray.util import get_node_ip_address

from tests.service import free_port, until

RAY = str(Path(sys.executable).parent / "ray")
MEMORY = 100_000_000
RESOURCE = "adr_trainer"  # of the autoscaler's nodes, one for their one core
# Ray's AutoscalingCluster ends every Ray on the machine, so this is its configuration without it
_FIRST = "f" * 51 + "0" * 5  # the provider's id of the head
_HEAD_TYPE = "ray.head.default"  # the provider's name for it
_PROVIDER = "ray.autoscaler._private.fake_multi_node.node_provider.FakeMultiNodeProvider"
_AUTOSCALER = {
    "AUTOSCALER_UPDATE_INTERVAL_S": "1",
    "RAY_FAKE_CLUSTER": "1",
    "RAY_enable_autoscaler_v2": "1",
    "RAY_CLOUD_INSTANCE_ID": _FIRST,
    "RAY_OVERRIDE_NODE_ID_FOR_TESTING": _FIRST,
}


@dataclass(frozen=True)
class Head:
    port: int
    process: subprocess.Popen[bytes]

    @property
    def address(self) -> str:
        return _address(self.port)

    def running(self, name: str) -> list[psutil.Process]:
        """Its processes of a name, as `raylet`: one for each node."""
        found = psutil.Process(self.process.pid).children(recursive=True)
        return [process for process in found if process.name() == name]


@contextmanager
def start_head(
    environment: Mapping[str, str], *, cores: int = 0, nodes: int = 0, port: int | None = None
) -> Generator[Head]:
    """A head of so many cores; its autoscaler may add `nodes` of one core each."""
    port = port or free_port()
    with TemporaryDirectory(prefix="adr-") as folder:  # short enough for Ray's sockets
        command = _command(Path(folder), port, cores, nodes)
        its_own = {**os.environ, **_AUTOSCALER, **environment, "RAY_USAGE_STATS_ENABLED": "0"}
        output = Path(folder, "output")
        with output.open("wb") as log:
            process = subprocess.Popen(command, env=its_own, stdout=log, stderr=subprocess.STDOUT)
        try:
            until(lambda: process.poll() or "will now block" in output.read_text())
            assert process.poll() is None, output.read_text()
            yield Head(port, process)
        finally:
            _end(process)


def _address(port: int) -> str:
    return f"{get_node_ip_address()}:{port}"


def _command(folder: Path, port: int, cores: int, nodes: int) -> list[str]:
    config = folder / "autoscaler.json"
    config.write_text(json.dumps(_configuration(_address(port), nodes)))
    command = [RAY, "start", "--head", "--block", f"--port={port}", f"--num-cpus={cores}"]
    command += ["--include-dashboard=false", f"--object-store-memory={MEMORY}"]
    return [*command, f"--temp-dir={folder}", f"--autoscaling-config={config}"]


def _end(head: subprocess.Popen[bytes]) -> None:
    processes = psutil.Process(head.pid).children(recursive=True) if head.poll() is None else []
    head.kill()
    head.wait()
    for process in processes:
        if process.is_running():
            process.kill()
    psutil.wait_procs(processes, timeout=30)


def _configuration(address: str, nodes: int) -> dict[str, object]:
    worker = {"CPU": 1, RESOURCE: 1, "object_store_memory": MEMORY}
    commands = ("initialization", "setup", "head_setup", "worker_setup")
    start = ("head_start_ray", "worker_start_ray")
    return {
        "cluster_name": "here",
        "max_workers": nodes,
        "idle_timeout_minutes": 0.05,
        "provider": {
            "type": "external",
            "module": _PROVIDER,
            "gcs_address": address,
            "head_node_id": _FIRST,
            "launch_multiple": True,
            "use_node_id_as_ip": True,
            "disable_node_updaters": True,
            "disable_launch_config_check": True,
        },
        "available_node_types": {
            _HEAD_TYPE: {"resources": {"CPU": 0}, "node_config": {}, "max_workers": 0},
            "worker": {"resources": worker, "node_config": {}, "max_workers": nodes},
        },
        "head_node_type": _HEAD_TYPE,
        "auth": {},
        "file_mounts": {},
        "cluster_synced_files": [],
        **{f"{name}_commands": [] for name in (*commands, *start)},
    }
