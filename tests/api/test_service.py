"""The service as a process: its start, its log and its files."""

import stat
import subprocess
import sys

import pytest

from api.service import Service
from api.settings import Settings
from tests.api.standins import Orchestrator
from workers.cluster import ClusterUnavailable

pytestmark = pytest.mark.ray


def test_without_a_core_work_is_refused_unless_an_autoscaler_is_asked_for_one():
    orchestrator = Orchestrator()
    orchestrator.cores = 0
    joined = {"ray_address": "head:6379", "resource": "adr_trainer"}
    with pytest.raises(ClusterUnavailable, match="no node of the cluster has any adr_trainer"):
        Service(Settings(**joined), None, orchestrator).check_cores()
    Service(Settings(**joined, max_cores=8), None, orchestrator).check_cores()


def test_the_log_has_a_line_for_every_stage(service, finished):
    lines = [line for line in service.log.read_text().splitlines() if "stage begun" in line]
    assert any(f"run={finished} " in line and "kind=infer " in line for line in lines)


def test_a_second_service_on_the_same_data_refuses_to_start(service):
    command = [sys.executable, "-m", "api", "serve", "--port", "0", "--data-dir"]
    given = [*command, str(service.data_dir)]
    done = subprocess.run(given, capture_output=True, text=True, timeout=60, check=False)
    assert done.returncode == 2
    assert "is in use by another service; stop it, or give this one another" in done.stderr
    assert "Traceback" not in done.stderr


def test_only_the_owner_can_read_rays_token(service):
    mode = (service.data_dir / "ray_token").stat().st_mode
    assert stat.S_IMODE(mode) == 0o600
    token = (service.data_dir / "ray_token").read_text()
    assert token not in service.log.read_text()


def test_it_listens_for_everyone_only_with_a_token(tmp_path):
    command = [sys.executable, "-m", "api", "serve", "--host", "0.0.0.0"]  # noqa: S104
    done = subprocess.run(
        command, capture_output=True, text=True, timeout=60, cwd=tmp_path, check=False
    )
    assert done.returncode == 2
    assert "set ADR_TOKEN" in done.stderr
