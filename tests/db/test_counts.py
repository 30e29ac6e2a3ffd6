"""Numbers for monitoring."""

from adr_service.events import RunStarted
from db import counts, events, runs, visits
from tests.db.leases import SPEC, START, claim, publish
from tests.db.rows import RESULT, STAGE, commit


def test_runs_stages_and_visits_are_counted_by_their_kinds(database):
    first, _ = (runs.create_run(database, SPEC).id for _ in range(2))
    events.append_event(database, first, RunStarted(submission=1))
    commit(database, STAGE, RESULT, first)
    ids = [publish(database, first, number) for number in range(2)]
    claimed = claim(database, "robot-7")
    seen = counts.count(database)
    assert seen.runs == {"running": 1, "queued": 1}
    assert seen.stages == {"evaluate": 1}
    assert seen.visits == {("claimed", True): 1, ("pending", True): 1}
    assert seen.claims == [(claimed.id, "robot-7", START)]
    assert ids[0] == claimed.id
    visits.release(database, claimed.id, claimed.lease)
    assert counts.count(database).claims == []
