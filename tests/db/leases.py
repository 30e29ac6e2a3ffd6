"""Visits of one task, and a robot that claims them at moments of the test's own clock."""

from datetime import UTC, datetime

from adr_service.specs import RunSpec
from adr_service.stages.base import StageResult
from db import visits
from tests.stages.examples import episode

SPEC = RunSpec.model_validate(
    {"task": "arm", "method": "simopt", "preset": "smoke", "target": {"kind": "external"}}
)
START = datetime(2026, 1, 1, tzinfo=UTC)
LEASE_S = 60.0


def publish(database, run_id, number=0):
    """Offer an episode; the id of its visit."""
    with database.write("test") as session:
        return visits.publish(session, episode(run_id, number), run_id, START).id


def claim(database, worker="robot", now=START, tasks=("arm",)):
    """Claim a visit of the task `arm`."""
    return visits.claim(database, worker, tasks, now, LEASE_S)


def complete(database, task, lease=None, content=b"data", now=START, earned=1.0):
    """Upload an episode of ten transitions."""
    result = StageResult({"transitions": 10, "return": earned}, {"data": content})
    return visits.complete(
        database, task.id, lease or task.lease, result, 10, now, lambda session: None
    )
