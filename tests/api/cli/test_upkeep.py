"""`adr db`, beside a service that has the database open."""

import sqlite3
import stat
from contextlib import closing

import pytest
from alembic import command
from typer.testing import CliRunner

from adr_service.errors import AdrError, InvalidInput
from api.cli import app, upkeep
from db import events, maintenance, runs
from db.errors import DatabaseInUse
from db.schema import alembic_config, head
from db.session import open_database
from tests.db.rows import SPEC
from workers.sessions import Sessions


@pytest.fixture
def database(file_database):
    return file_database


def adr(tmp_path, *arguments):
    return CliRunner().invoke(app, ["db", *arguments, "--data-dir", str(tmp_path)])


def test_a_sound_database_is_reported_with_its_counts(database, tmp_path):
    runs.create_run(database, SPEC)
    shown = adr(tmp_path, "check").output.replace("\n", "")
    assert "is sound: 0 benchmarks, 1 runs, 1 events" in shown


def test_restore_replaces_a_damaged_file_and_keeps_it_beside(tmp_path):
    path, copy = tmp_path / "adr.sqlite", tmp_path / "copy.sqlite"
    with closing(open_database(f"sqlite:///{path}")) as database:
        run = runs.create_run(database, SPEC)
        maintenance.backup(path, copy)
        in_use = adr(tmp_path, "restore", str(copy))
        assert isinstance(in_use.exception, DatabaseInUse)
    with closing(Sessions(tmp_path)):  # of a service whose database was deleted
        in_use = adr(tmp_path, "restore", str(copy))
        assert "a service runs in" in str(in_use.exception)
    path.write_bytes(b"what?")
    assert "is copy.sqlite now" in adr(tmp_path, "restore", str(copy)).output.replace(
        "\n", ""
    ).replace(str(tmp_path) + "/", "")
    with closing(open_database(f"sqlite:///{path}")) as database:
        assert runs.get_run(database, run.id) == run
    (aside,) = tmp_path.glob("adr.sqlite.*.replaced")
    assert aside.read_bytes() == b"what?"
    assert stat.S_IMODE(path.stat().st_mode) == 0o600
    copy.write_bytes(b"what?")
    assert "cannot be read" in str(adr(tmp_path, "restore", str(copy)).exception)


def test_a_restore_that_fails_makes_no_database_beside_its_log(tmp_path):
    """Else the service would begin with an empty one, and what the log has would be lost."""
    (tmp_path / "adr.sqlite-wal").write_bytes(b"the last transactions")
    failed = adr(tmp_path, "restore", str(tmp_path / "mistyped.sqlite"))
    assert "there is no database" in str(failed.exception)
    with pytest.raises(InvalidInput, match="is not there, but its log is"):
        open_database(f"sqlite:///{tmp_path / 'adr.sqlite'}")


def test_a_database_of_a_later_version_is_told_from_an_upgrade_that_was_cut_short(
    database, tmp_path
):
    with closing(sqlite3.connect(tmp_path / "adr.sqlite", isolation_level=None)) as file:
        file.execute("update alembic_version set version_num = '9999'")
    failed = str(adr(tmp_path, "check").exception)
    assert "revision 9999 is of a later version of the service: read it with that one" in failed
    assert "cut short" not in failed


@pytest.mark.parametrize("page", range(1, 40, 3))
def test_check_and_the_service_both_report_a_hole_in_the_file(tmp_path, page):
    path = tmp_path / "adr.sqlite"
    with closing(open_database(f"sqlite:///{path}")) as database:
        for _ in range(40):
            runs.create_run(database, SPEC)
    with path.open("r+b") as file:
        file.seek(4096 * page)
        file.write(bytes(4096))
    failed = adr(tmp_path, "check")
    assert isinstance(failed.exception, upkeep.Damaged), failed.output
    assert "restore a backup" in str(failed.exception)
    try:
        with closing(open_database(f"sqlite:///{path}")) as database:
            runs.unfinished_runs(database)
            for run in runs.list_runs(database):
                events.events_of(database, run.id)
            runs.create_run(database, SPEC)
    except AdrError as error:
        assert "damaged" in str(error)  # noqa: PT017 - some pages are of no use to these


def test_an_older_database_is_upgraded(tmp_path):
    command.upgrade(alembic_config(f"sqlite:///{tmp_path / 'adr.sqlite'}"), "0001")
    assert "is sound" in adr(tmp_path, "check").output.replace("\n", "")
    shown = adr(tmp_path, "upgrade").output.replace("\n", "")
    assert shown.endswith(f"revision 0001 -> {head()}")


def test_damage_is_listed_with_advice(database, tmp_path):
    with closing(sqlite3.connect(tmp_path / "adr.sqlite")) as other, other:
        other.execute("insert into events values ('run_gone', 1, 'k', 't', '{}', '2026-01-01')")
    failed = adr(tmp_path, "check").exception
    assert isinstance(failed, upkeep.Damaged)
    advice, damage = str(failed).splitlines()
    assert "restore a backup" in advice
    assert damage == "row 1 of events refers to a row of runs that is not there"


def test_a_backup_is_reported_with_its_size(database, tmp_path):
    done = adr(tmp_path, "backup", str(tmp_path / "copy.sqlite"))
    assert done.exit_code == 0
    assert done.output.rstrip().endswith(" MB")


def test_a_database_in_postgresql_is_left_to_the_servers_own_tools(monkeypatch):
    monkeypatch.setenv("ADR_DATABASE_URL", "postgresql+psycopg://me@127.0.0.1:9/adr")
    refused = CliRunner().invoke(app, ["db", "check"])
    assert "pg_dump" in str(refused.exception)
