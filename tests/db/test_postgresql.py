"""PostgreSQL alone: its connections and its refusals."""

from contextlib import closing

import pytest
from sqlalchemy import text

from adr_service.errors import InvalidInput
from db import runs, stages
from db.errors import DatabaseInUse, DatabaseUnavailable
from db.models import ResultsRow
from db.session import Database, open_database
from tests.db.rows import SPEC, count


@pytest.fixture
def url(postgresql):
    return postgresql.new_database()


def test_a_lost_connection_comes_back_and_keeps_others_away(url, postgresql):
    with closing(open_database(url)) as database:
        run = runs.create_run(database, SPEC)
        postgresql.cut(url)
        assert runs.get_run(database, run.id) == run
        runs.create_run(database, SPEC)
        with pytest.raises(DatabaseInUse, match="in use by another service"):
            open_database(url)


def test_a_service_that_lost_the_lock_to_another_cannot_write(url, postgresql):
    with closing(open_database(url)) as database:
        postgresql.cut(url)
        with closing(open_database(url)) as second:
            runs.create_run(second, SPEC)
            with pytest.raises(DatabaseInUse):
                runs.create_run(database, SPEC)
            assert count(database, "runs") == 1
        runs.create_run(database, SPEC)  # the other has gone
        assert count(database, "runs") == 2


def test_a_connection_lost_in_a_transaction_stores_nothing_of_it(url, postgresql):
    with closing(open_database(url)) as database:
        lost = pytest.raises(DatabaseUnavailable, match="cannot be used just now")
        with lost, database.write("test") as session:
            stages.add_artifact(session, b"policy")
            postgresql.cut(url)
            stages.add_artifact(session, b"another")
        assert count(database, "artifacts") == 0


def test_a_server_that_takes_no_writes_any_more_is_waited_for(url, postgresql):
    with closing(open_database(url)) as database:
        run = runs.create_run(database, SPEC)
        with postgresql.read_only():
            # on the connection that there was, and on a new one, which may find another server
            for message in ("cannot execute INSERT", "session is read-only"):
                with pytest.raises(DatabaseUnavailable, match=message):
                    runs.create_run(database, SPEC)
            assert runs.get_run(database, run.id) == run
        runs.create_run(database, SPEC)
        assert count(database, "runs") == 2


def test_values_that_it_cannot_store_are_invalid_input(url):
    with closing(open_database(url)) as database:
        with pytest.raises(InvalidInput, match="cannot store this"):
            runs.list_runs(database, task="hop\0per")
        with pytest.raises(InvalidInput, match="too long"), database.write("test") as session:
            session.add(ResultsRow(id="x" * 41, version="", body=""))


def test_options_of_the_url_apply_to_tables_and_rows(url, postgresql):
    with closing(Database(url)) as database, database.write("test") as session:
        session.execute(text("create schema s"))
    with closing(
        open_database(f"{url}&options=-csearch_path%3Ds&options=-cwork_mem%3D5MB")
    ) as database:
        runs.create_run(database, SPEC)
        assert count(database, "s.runs") == 1
        with database.read() as session:
            assert session.scalar(text("show work_mem")) == "5MB"


def test_an_absent_server_is_reported_without_the_password():
    with pytest.raises(DatabaseUnavailable, match="cannot be used just now") as refused:
        open_database("postgresql+psycopg://me:secret@127.0.0.1:9/adr")
    assert "secret" not in str(refused.value)
