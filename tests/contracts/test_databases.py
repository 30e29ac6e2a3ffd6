"""The promises of every kind of database, asked of each."""

import threading
from datetime import UTC, datetime, timedelta

import pytest
from sqlalchemy import text
from sqlalchemy.exc import DBAPIError, IntegrityError

from adr_service.events import RunState
from db import results, runs, stages, visits
from db.errors import DatabaseInUse
from db.models import RunRow, VisitState
from db.session import open_database
from tests.db.rows import SPEC, count
from tests.stages.examples import episode


def test_a_reader_cannot_write(database):
    refused = pytest.raises(DBAPIError, match=r"readonly|read-only transaction")
    with refused, database.read() as session:
        session.execute(text("delete from runs"))


def test_a_reader_sees_one_moment(database):
    with database.read() as session:
        assert session.scalar(text("select count(*) from runs")) == 0
        runs.create_run(database, SPEC)
        assert session.scalar(text("select count(*) from runs")) == 0
    assert count(database, "runs") == 1


def test_no_update_is_lost_between_threads(database):
    run = runs.create_run(database, SPEC)

    def increment():
        for _ in range(50):
            with database.write("test") as session:
                row = session.query(RunRow).filter_by(id=run.id).one()
                row.seed = row.seed + 1

    threads = [threading.Thread(target=increment) for _ in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    with database.read() as session:
        assert session.query(RunRow).filter_by(id=run.id).one().seed == 200


def test_a_second_service_on_the_same_database_is_refused(database):
    with pytest.raises(DatabaseInUse, match="in use by another service"):
        open_database(database.url)


def test_another_service_may_have_a_closed_database(database):
    database.close()
    open_database(database.url).close()


def test_a_transaction_that_raises_stores_nothing(database):
    def store_and_fail(session):
        stages.add_artifact(session, b"policy")
        raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError), database.write("test") as session:
        store_and_fail(session)
    assert count(database, "artifacts") == 0


def test_a_commit_is_seen_by_the_next_reader(database):
    with database.write("test") as session:
        stages.add_artifact(session, b"policy")
    assert count(database, "artifacts") == 1


def test_bytes_and_text_come_back_exactly(database):
    content = bytes(range(256))
    with database.write("test") as session:
        key = stages.add_artifact(session, content)
    assert stages.artifact(database, key) == content
    run = runs.create_run(database, SPEC)
    results.keep_results(database, run.id, "1", "ξ̄ “Ω” \U0001f916")
    assert results.kept_results(database, run.id, "1") == "ξ̄ “Ω” \U0001f916"


def test_times_come_back_in_utc(database):
    record = runs.create_run(database, SPEC)
    assert record.created_at.utcoffset() == timedelta(0)
    assert runs.get_run(database, record.id).created_at == record.created_at


@pytest.mark.parametrize(
    "change", ["state = 'sleeping'", "state = 'failed'", "submission = 0", "error_code = 'x'"]
)
def test_impossible_runs_are_refused_by_the_database_itself(database, change):
    run = runs.create_run(database, SPEC)
    with pytest.raises(IntegrityError), database.write("test") as session:
        session.execute(text(f"update runs set {change} where id = '{run.id}'"))  # noqa: S608


def test_every_state_of_runs_and_visits_can_be_stored(database):
    run = runs.create_run(database, SPEC)
    with database.write("test") as session:
        for state in RunState:
            row = session.get_one(RunRow, run.number)
            row.state, row.error_code = state, "x" if state == RunState.FAILED else None
            session.flush()
    visit = episode(run.id)
    with database.write("test") as session:
        row = visits.publish(session, visit, run.id, datetime.now(UTC))
        for state in VisitState:
            row.state, row.error = state, "x" if state == VisitState.FAILED else None
            row.expires_at = datetime.now(UTC) if state == VisitState.CLAIMED else None
            session.flush()
