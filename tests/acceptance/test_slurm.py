"""The script that Slurm runs on a job's first machine, without Slurm."""

import os
import signal
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest

from tests.heads import start_head
from tests.service import free_port, until
from tests.test_deploy import SLURM

pytestmark = [pytest.mark.ray, pytest.mark.slow]
BENCHMARK = """{"tasks": ["arm"], "methods": ["udr"], "seeds": [0], "preset": "smoke",
    "training": {"max_steps": 6000, "evaluate_every": 3000}}"""


def test_a_job_that_was_stopped_goes_on_and_leaves_an_archive(tmp_path, secret):
    benchmark, data = tmp_path / "benchmark.json", tmp_path / "data"
    benchmark.write_text(BENCHMARK)
    command = ["bash", SLURM / "benchmark.sh", benchmark, data]
    path = f"{Path(sys.executable).parent}:{os.environ['PATH']}"
    with start_head(secret, cores=1) as head:
        settings = {"ADR_RAY_ADDRESS": head.address, "ADR_PORT": str(free_port()), "PATH": path}
        environment = {**os.environ, **secret, **settings, "ADR_URL": "http://127.0.0.1:9"}
        with (tmp_path / "log").open("wb") as log:
            log_to = {"stdout": log, "stderr": subprocess.STDOUT, "env": environment}
            first = subprocess.Popen(command, **log_to)
            until(lambda: "stage begun" in (tmp_path / "log").read_text())
            first.send_signal(signal.SIGTERM)
            assert first.wait(120) == 143
            assert list(data.glob("*.adr")) == []
            subprocess.run(command, check=True, timeout=600, **log_to)
            (archive,) = data.glob("benchmark-*.adr")
            subprocess.run(command, check=True, timeout=600, **log_to)  # queued again after its end
    assert zipfile.is_zipfile(archive)
