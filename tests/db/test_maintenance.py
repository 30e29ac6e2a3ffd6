"""Upkeep of an SQLite file, beside a service that has it open."""

import os
import shutil
import sqlite3
import stat
from contextlib import closing, contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory

import pytest

from adr_service.errors import InvalidInput
from db import maintenance, runs, stages
from db.errors import DatabaseNewer
from db.session import open_database
from tests.db.rows import SPEC, count


@pytest.fixture
def database(file_database):
    return file_database


def test_check_lists_each_damage(database, tmp_path):
    with database.write("test") as session:
        key = stages.add_artifact(session, b"policy")
    with closing(sqlite3.connect(tmp_path / "adr.sqlite")) as other, other:
        other.execute("update artifacts set content = cast('polizy' as blob)")
        other.execute("insert into events values ('run_gone', 1, 'k', 't', '{}', '2026-01-01')")
    lines = maintenance.check(tmp_path / "adr.sqlite")
    assert lines == [
        "row 1 of events refers to a row of runs that is not there",
        f"artifact {key} has other bytes than its name says",
    ]


def test_check_names_the_rows_that_cannot_be_read(database, tmp_path):
    one, other = (runs.create_run(database, SPEC).number for _ in range(2))
    with closing(sqlite3.connect(tmp_path / "adr.sqlite")) as hand, hand:
        hand.execute("update runs set spec = '[1]' where number = ?", [one])
        hand.execute("update runs set task = cast(x'61ff' as text) where number = ?", [other])
        hand.execute("update events set body = '{' where rowid = 1")
    assert maintenance.check(tmp_path / "adr.sqlite") == [
        f"row {other} of runs: its task is not UTF-8 text",
        f"row {one} of runs: its spec is not a JSON object",
        "row 1 of events: its body is not a JSON object",
    ]


def test_a_backup_has_everything_and_overwrites_nothing(database, tmp_path):
    run = runs.create_run(database, SPEC)
    copy = tmp_path / "copy.sqlite"
    maintenance.backup(tmp_path / "adr.sqlite", copy)
    runs.create_run(database, SPEC)  # not in it
    with closing(open_database(f"sqlite:///{copy}")) as restored:
        assert runs.get_run(restored, run.id) == run
        assert count(restored, "runs") == 1
    with pytest.raises(InvalidInput, match="is there already"):
        maintenance.backup(tmp_path / "adr.sqlite", copy)
    with pytest.raises(InvalidInput, match=r"could not be copied to .*nowhere"):
        maintenance.backup(tmp_path / "adr.sqlite", tmp_path / "nowhere" / "copy.sqlite")


def test_a_backup_is_read_where_nothing_can_be_written(database, tmp_path):
    """As a snapshot is mounted. A file of a service that was stopped is in WAL mode."""
    run = runs.create_run(database, SPEC)
    with TemporaryDirectory(dir="/tmp") as place:  # whose parents anybody may enter
        copy, stopped = Path(place) / "copy.sqlite", Path(place) / "stopped.sqlite"
        maintenance.backup(tmp_path / "adr.sqlite", copy)
        assert stat.S_IMODE(copy.stat().st_mode) == 0o600
        database.close()
        shutil.copyfile(tmp_path / "adr.sqlite", stopped)
        for path in (copy, stopped):
            path.chmod(0o444)
        Path(place).chmod(0o555)
        with as_nobody():
            found = [maintenance.counts(path)["runs"] for path in (copy, stopped)]
        assert found == [1, 1]
        assert sorted(path.name for path in Path(place).iterdir()) == [copy.name, stopped.name]
        Path(place).chmod(0o700)
        maintenance.restore(tmp_path / "adr.sqlite", copy)
    with closing(open_database(f"sqlite:///{tmp_path / 'adr.sqlite'}")) as restored:
        assert runs.get_run(restored, run.id) == run


@contextmanager
def as_nobody():
    """Run as a user without rights, because root may write anywhere."""
    user = os.geteuid()
    if user == 0:
        os.seteuid(65534)
    try:
        yield
    finally:
        os.seteuid(user)


def test_what_a_restore_replaced_can_be_restored_with_its_log(database, tmp_path):
    """The log of a service that was killed holds what it stored last."""
    path, killed, copy = (tmp_path / name for name in ("adr.sqlite", "killed.sqlite", "copy"))
    maintenance.backup(path, copy)
    run = runs.create_run(database, SPEC)
    for suffix in ("", "-wal"):
        shutil.copyfile(f"{path}{suffix}", f"{killed}{suffix}")
    aside = maintenance.restore(killed, copy)
    assert maintenance.counts(killed)["runs"] == 0
    maintenance.restore(killed, aside)
    with closing(open_database(f"sqlite:///{killed}")) as restored:
        assert runs.get_run(restored, run.id) == run


def test_a_restore_that_dies_at_its_end_loses_nothing_of_the_old_database(
    database, tmp_path, monkeypatch
):
    path, killed, copy = (tmp_path / name for name in ("adr.sqlite", "killed.sqlite", "copy"))
    maintenance.backup(path, copy)
    run = runs.create_run(database, SPEC)
    for suffix in ("", "-wal"):
        shutil.copyfile(f"{path}{suffix}", f"{killed}{suffix}")
    replace = Path.replace

    def die(self, target):
        if Path(target) == killed:
            raise KeyboardInterrupt
        return replace(self, target)

    monkeypatch.setattr(Path, "replace", die)
    with pytest.raises(KeyboardInterrupt):
        maintenance.restore(killed, copy)
    monkeypatch.undo()
    with closing(open_database(f"sqlite:///{killed}")) as old:
        assert runs.get_run(old, run.id) == run


def test_a_backup_of_a_later_version_is_refused_before_anything_is_replaced(database, tmp_path):
    path, killed, copy = (tmp_path / name for name in ("adr.sqlite", "killed.sqlite", "copy"))
    run = runs.create_run(database, SPEC)
    for file in (killed, copy):
        maintenance.backup(path, file)
    with closing(sqlite3.connect(copy)) as later, later:
        later.execute("update alembic_version set version_num = '9999'")
    with pytest.raises(DatabaseNewer, match="revision 9999, which this version does not know"):
        maintenance.restore(killed, copy)
    assert list(tmp_path.glob("*.replaced")) == []
    with closing(open_database(f"sqlite:///{killed}")) as old:
        assert runs.get_run(old, run.id) == run


def test_a_file_without_tables_is_said_to_have_none_and_restores_nothing(database, tmp_path):
    """As where the first start was killed. A table was missed in it by name."""
    (empty := tmp_path / "empty.sqlite").touch()
    reason = "it has no tables: none were made yet, or it was emptied"
    assert maintenance.check(empty) == [reason]
    with pytest.raises(InvalidInput, match=f"was not restored\n{reason}"):
        maintenance.restore(tmp_path / "adr.sqlite", empty)


def test_a_file_that_is_no_database_is_refused(tmp_path):
    with pytest.raises(InvalidInput, match="there is no database"):
        maintenance.check(tmp_path / "adr.sqlite")
    (tmp_path / "adr.sqlite").write_text("a letter, and not a short one at all" * 20)
    with pytest.raises(InvalidInput, match="cannot be read as a database"):
        maintenance.check(tmp_path / "adr.sqlite")


def test_a_file_that_cannot_be_opened_is_refused_by_name(tmp_path, monkeypatch):
    """As one of another user; the tests may run as root, who can open all."""

    def connect(*_, **__):
        raise sqlite3.OperationalError("unable to open database file")

    (tmp_path / "copy.sqlite").touch()
    monkeypatch.setattr(sqlite3, "connect", connect)
    with pytest.raises(InvalidInput, match=r"copy.sqlite cannot be read as a database: unable to"):
        maintenance.restore(tmp_path / "adr.sqlite", tmp_path / "copy.sqlite")
