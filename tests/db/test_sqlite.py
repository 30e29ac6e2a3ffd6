"""SQLite alone: its file, its log and its lock."""

import os
import shutil
import sqlite3
import stat
from contextlib import closing
from types import SimpleNamespace

import pytest
from sqlalchemy import text
from sqlalchemy.exc import OperationalError

from adr_service.errors import InvalidInput
from db import runs, stages
from db.errors import DatabaseGone, DatabaseInUse, DatabaseUnavailable, DiskFull
from db.session import Database, open_database
from tests.db.rows import SPEC, count


def test_a_committed_run_is_on_disk_for_any_other_reader(file_database, tmp_path):
    run = runs.create_run(file_database, SPEC)
    with sqlite3.connect(tmp_path / "adr.sqlite") as other:
        assert other.execute("select id from runs").fetchall() == [(run.id,)]
    other.close()


def test_the_writer_waits_for_the_disk(file_database):
    with file_database.write("test") as session:
        assert session.scalar(text("pragma journal_mode")) == "wal"
        assert session.scalar(text("pragma synchronous")) == 2  # FULL
        assert session.scalar(text("pragma foreign_keys")) == 1


def test_a_foreign_lock_and_a_full_disk_are_distinct_from_defects(tmp_path, monkeypatch):
    monkeypatch.setattr("db.sqlite.BUSY_TIMEOUT_MS", 50)
    with closing(open_database(f"sqlite:///{tmp_path / 'adr.sqlite'}")) as database:
        with closing(sqlite3.connect(tmp_path / "adr.sqlite", isolation_level=None)) as other:
            other.execute("begin immediate")
            with pytest.raises(DatabaseUnavailable, match="locked"):
                runs.create_run(database, SPEC)
        run = runs.create_run(database, SPEC)
        with database.write("test") as session:
            session.execute(text("pragma max_page_count=1"))  # as many as there are
        with (
            pytest.raises(DiskFull, match="free some space"),
            database.write("test") as session,
        ):
            stages.add_artifact(session, bytes(10_000_000))
        with pytest.raises(OperationalError, match="no such table"), database.read() as session:
            session.execute(text("select 1 from nowhere"))
        assert runs.get_run(database, run.id).state == "queued"
        assert count(database, "artifacts") == 0


@pytest.mark.parametrize("file", ["adr.sqlite", "adr.sqlite-wal"])
@pytest.mark.parametrize("how", ["deleted", "replaced"])
def test_files_that_go_away_under_a_service_stop_its_writes(file_database, tmp_path, file, how):
    runs.create_run(file_database, SPEC)
    (tmp_path / file).rename(tmp_path / "elsewhere")
    if how == "replaced":
        shutil.copy(tmp_path / "elsewhere", tmp_path / file)
    with pytest.raises(DatabaseGone, match=rf"{file} was deleted or replaced"):
        runs.create_run(file_database, SPEC)


def test_a_log_without_its_database_is_not_thrown_away(tmp_path):
    """The database may have been moved, and its last commits are in the log."""
    path = tmp_path / "adr.sqlite"
    database = open_database(f"sqlite:///{path}")
    run = runs.create_run(database, SPEC)
    killed = tmp_path / "killed"
    killed.mkdir()
    for file in tmp_path.glob("adr.sqlite*"):
        shutil.copy(file, killed)
    database.close()
    url = f"sqlite:///{killed / 'adr.sqlite'}"
    (killed / "adr.sqlite").rename(killed / "moved")
    with pytest.raises(InvalidInput, match=r"not there, but its log is \(adr.sqlite-wal\)"):
        open_database(url)
    (killed / "adr.sqlite-wal").rename(killed / "log")
    (killed / "adr.sqlite-wal").touch()  # it has nothing to lose
    with closing(open_database(url)) as database:
        assert runs.list_runs(database) == []
    for file in killed.glob("adr.sqlite*"):
        file.unlink()
    (killed / "log").rename(killed / "adr.sqlite-wal")
    (killed / "moved").rename(killed / "adr.sqlite")
    with closing(open_database(url)) as database:
        assert runs.get_run(database, run.id) == run


def test_no_file_beside_the_database_holds_its_lock(file_database, tmp_path):
    for file in tmp_path.glob("adr.sqlite?lock*"):
        file.unlink()
    with pytest.raises(DatabaseInUse):
        Database(file_database.url)


def test_a_new_database_is_readable_by_its_owner_alone(tmp_path):
    tmp_path.chmod(0o755)
    with closing(open_database(f"sqlite:///{tmp_path / 'x.sqlite'}")) as database:
        runs.create_run(database, SPEC)
        modes = {f.name: stat.S_IMODE(f.stat().st_mode) for f in tmp_path.glob("x.sqlite*")}
    assert modes == dict.fromkeys(("x.sqlite", "x.sqlite-wal", "x.sqlite-shm"), 0o600)


def test_deleting_gives_disk_space_back(tmp_path):
    """Also in a file that was made by a version which did not."""
    path = tmp_path / "adr.sqlite"
    with closing(sqlite3.connect(path)) as old:
        old.execute("create table somebody_elses (x)")
    with closing(open_database(f"sqlite:///{path}")) as database:
        with database.write("test") as session:
            key = stages.add_artifact(session, os.urandom(40_000_000))
        with database.write("test") as session:
            session.execute(text("delete from artifacts where sha256 = :key"), {"key": key})
        portions = 1
        while database.reclaim():
            portions += 1
        with database.write("test") as session:
            session.execute(text("select 1"))
        assert portions > 3  # others may write in between
    assert path.stat().st_size < 1_000_000


def test_a_file_that_could_not_be_rewritten_keeps_its_space_and_ends_the_round(
    tmp_path, monkeypatch
):
    nothing = SimpleNamespace(free=0)
    monkeypatch.setattr("db.sqlite.shutil.disk_usage", lambda _: nothing)
    path = tmp_path / "adr.sqlite"
    with closing(sqlite3.connect(path)) as old:
        old.execute("create table somebody_elses (x)")
    with closing(open_database(f"sqlite:///{path}")) as database:
        with database.write("test") as session:
            key = stages.add_artifact(session, os.urandom(20_000_000))
        with database.write("test") as session:
            session.execute(text("delete from artifacts where sha256 = :key"), {"key": key})
        assert not database.reclaim()
    assert path.stat().st_size > 20_000_000
