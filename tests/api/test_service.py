"""The service as a process: its start, its log and its files."""

import shutil
import stat
import subprocess
import sys
from datetime import UTC, datetime, timedelta
from types import SimpleNamespace

import pytest

from adr_service.errors import InvalidInput
from adr_service.events import RunSucceeded
from api.service import Service, open_service
from api.settings import Settings
from db import events, runs
from db.clock import SteadyClock
from db.errors import DatabaseInUse, DiskFull
from tests.api.standins import Orchestrator
from tests.db.rows import SPEC
from workers.cluster import ClusterUnavailable

pytestmark = pytest.mark.ray


@pytest.mark.parametrize("broken", ["start", "renew_leases"])
def test_a_start_that_fails_ends_what_it_began(tmp_path, monkeypatch, broken):
    """Ray and the threads of runs went on, without a lock on the database."""
    did = []

    class Starting(Orchestrator):
        def __init__(self, *_, **__):
            super().__init__()

        def start(self):
            did.append("start")
            if broken == "start":
                raise DiskFull("no room")

        def close(self):
            did.append("close")

    def renew(*_):
        raise DiskFull("no room")

    monkeypatch.setattr("api.service.Orchestrator", Starting)
    monkeypatch.setattr("db.staging.clear", lambda folder: did.append("clear"))
    monkeypatch.setattr("db.visits.renew_leases", renew)
    for _ in range(2):  # the database is free again
        with pytest.raises(DiskFull):
            open_service(Settings(data_dir=tmp_path))
    clear = [] if broken == "start" else ["clear"]  # not in a folder that another service has
    assert did == ["start", *clear, "close"] * 2


def test_without_a_core_work_is_refused_unless_an_autoscaler_is_asked_for_one():
    orchestrator = Orchestrator()
    orchestrator.cores = 0
    joined = {"ray_address": "head:6379", "resource": "adr_trainer"}
    with pytest.raises(ClusterUnavailable, match="no node of the cluster has any adr_trainer"):
        Service(Settings(**joined), None, orchestrator, None).check_cores()
    Service(Settings(**joined, max_cores=8), None, orchestrator, None).check_cores()


@pytest.mark.parametrize("hours", [-2, 2])
def test_nothing_expires_while_the_clock_has_been_set_by_hours(file_database, hours, caplog):
    """A clock that jumps by years would delete all results for good."""
    run = runs.create_run(file_database, SPEC)
    events.append_event(file_database, run.id, RunSucceeded())
    service = Service(Settings(retention_days=1e-9), file_database, Orchestrator(), None)
    assert [id for _, id in service.expired()] == [run.id]
    assert not caplog.records
    then = datetime.now(UTC) - timedelta(hours=hours)
    service.orchestrator.clock = SteadyClock(wall=lambda: then, steady=lambda: 0.0)
    assert service.expired() == []
    (warning,) = caplog.messages
    assert f"since the service started it has become {then:%Y-%m-%d %H:%M}" in warning


@pytest.mark.parametrize("full", ["data", "small"])
def test_work_is_refused_where_the_disk_of_the_data_or_of_the_database_is_full(
    tmp_path, monkeypatch, full
):
    free = {tmp_path / "data": 2 * 10**9, tmp_path / "small": 10**9, tmp_path / full: 10**6}
    monkeypatch.setattr(shutil, "disk_usage", lambda path: SimpleNamespace(free=free[path]))
    url = f"sqlite:///{tmp_path / 'small' / 'adr.sqlite'}"
    settings = Settings(data_dir=tmp_path / "data", database_url=url)
    service = Service(settings, None, Orchestrator(), None)
    assert service.free_disk() == 10**6
    with pytest.raises(DiskFull, match="has 1 MB left; new work is refused below 500"):
        service.check_disk()


def test_a_folder_of_others_is_not_closed(tmp_path):
    (tmp_path / "letter.txt").touch()
    tmp_path.chmod(0o755)
    with pytest.raises(InvalidInput, match=r"is open to others \(mode 755\) and has other files"):
        open_service(Settings(data_dir=tmp_path))
    assert stat.S_IMODE(tmp_path.stat().st_mode) == 0o755


@pytest.mark.parametrize(
    "files", [[], ["adr.sqlite", "letter.txt"], ["ray_token"], ["service.log"], ["films"]]
)
def test_an_empty_folder_and_one_of_the_service_are_closed(tmp_path, files):
    for name in files:
        (tmp_path / name).touch()
    tmp_path.chmod(0o755)
    nowhere = f"sqlite:///{tmp_path / 'nowhere' / 'adr.sqlite'}"  # so that it goes no further
    with pytest.raises(InvalidInput, match="there is no folder"):
        open_service(Settings(data_dir=tmp_path, database_url=nowhere))
    assert stat.S_IMODE(tmp_path.stat().st_mode) == 0o700


def test_the_log_has_a_line_for_every_stage(service, finished):
    lines = [line for line in service.log.read_text().splitlines() if "stage begun" in line]
    assert any(f"run={finished} " in line and "kind=infer " in line for line in lines)


def test_a_second_service_on_the_same_data_refuses_to_start(service):
    message = "is in use by another service; stop it, or give this one another"
    with pytest.raises(DatabaseInUse, match=message):
        open_service(Settings(data_dir=service.data_dir))


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
