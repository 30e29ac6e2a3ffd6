"""The start of a service: it deletes expired runs, and goes on with unfinished ones."""

from datetime import UTC, datetime, timedelta

import pytest
from sqlalchemy import update

from adr_service.client import Refused
from adr_service.events import RunSucceeded
from adr_service.specs import RunSpec
from db import events, runs
from db.models import RunRow
from db.session import open_database
from tests.service import start_service, until

pytestmark = pytest.mark.ray
SPEC = RunSpec.model_validate({"task": "arm", "method": "prior", "preset": "smoke"})


@pytest.mark.slow
def test_finished_runs_go_after_their_time_and_unfinished_ones_are_taken_up(tmp_path):
    database = open_database(f"sqlite:///{tmp_path / 'adr.sqlite'}")
    old, recent, left = (runs.create_run(database, SPEC).id for _ in range(3))
    events.append_event(database, old, RunSucceeded())
    events.append_event(database, recent, RunSucceeded())
    runs.request_cancel(database, left)  # an end that needs no computing
    with database.write("test") as session:
        days_ago = datetime.now(UTC) - timedelta(days=3)
        session.execute(update(RunRow).where(RunRow.id != recent).values(updated_at=days_ago))
    database.close()
    with start_service(tmp_path, cpus=1, environment={"ADR_RETENTION_DAYS": "2"}) as running:
        until(lambda: f"{old} was deleted" in running.log.read_text())
        with pytest.raises(Refused, match=f"there is no run '{old}'"):
            running.client.get(old)
        until(lambda: running.client.get(left)["state"] == "cancelled")
        assert running.client.get(recent)["state"] == "succeeded"
    said = running.log.read_text()  # that it was stopped, which does not look like a crash
    assert "Finished server process" in said
    assert "SIGTERM" not in said.partition("Application startup complete")[2]
