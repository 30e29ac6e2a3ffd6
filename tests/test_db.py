"""The database: transactions, constraints, migrations, and one writer."""

import os
import shutil
import sqlite3
import stat
import subprocess
import sys
import threading
from contextlib import closing, contextmanager
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from alembic import command
from sqlalchemy import Engine, inspect, text
from sqlalchemy import event as engine_event
from sqlalchemy.exc import DBAPIError, IntegrityError, OperationalError
from typer.testing import CliRunner

from adr_service.benchmark.utilisation import Timing
from adr_service.errors import AdrError, InvalidInput
from adr_service.events import (
    RunFailed,
    RunQueued,
    RunStarted,
    RunStopped,
    RunSucceeded,
    StageFinished,
    TrainingEvaluated,
    state_after,
)
from adr_service.json_values import canonical_json, sha256
from adr_service.presets import PRESETS
from adr_service.specs import BenchmarkExtension, BenchmarkSpec, RunSpec
from adr_service.stages import Stage, StageResult
from adr_service.transitions import TransitionDataset
from api.cli import app, upkeep
from db import datasets, maintenance, runs, schema, stages
from db.errors import (
    DatabaseDamaged,
    DatabaseGone,
    DatabaseInUse,
    DatabaseNewer,
    DatabaseUnavailable,
    DiskFull,
    NotFound,
    NotPossible,
)
from db.models import ResultsRow, RunRow
from db.schema import alembic_config, head
from db.session import Database, open_database
from workers.sessions import Sessions

SPEC = RunSpec.model_validate({"task": "arm", "method": "prior", "preset": "smoke"})
STAGE = Stage("evaluate", {"x": 1})
TIMING = Timing(100.0, 101.0, 101.5, 102.0, cpu=0.4, preparing=0.1, is_first=True, cores=2)
AN_ARTIFACT = "insert into artifacts values (?, 1, x'00')", (sha256(bytes(1)),)
EXECUTION = stages.Execution(1, "run_a", 0.5, TIMING, {"python": "3.11"})


def commit(database, stage, result, *run_ids):
    event = StageFinished(kind=stage.kind, digest=stage.digest)
    with database.write("commit") as session:
        document = canonical_json(stage.document)
        stages.add_result(session, stage.digest, document, result, EXECUTION)
        for run_id in run_ids:
            runs.append(session, run_id, event)


def count(database, table):
    with database.read() as session:
        return session.scalar(text(f"select count(*) from {table}"))  # noqa: S608 - our own names


@contextmanager
def statements():
    """Collect the statements that are sent to any database meanwhile."""
    sent = []
    note = lambda *given: sent.append(given[2])  # noqa: E731
    engine_event.listen(Engine, "before_cursor_execute", note)
    try:
        yield sent
    finally:
        engine_event.remove(Engine, "before_cursor_execute", note)


def found(database, digest):
    with database.read() as session:
        return stages.find_result(session, digest)


class TestRuns:
    def test_a_stored_run_comes_back_whole_and_queued(self, database):
        record = runs.create_run(database, SPEC)
        assert runs.get_run(database, record.id) == record
        assert (record.spec, record.state, record.submission) == (SPEC, "queued", 1)
        assert record.created_at.tzinfo is not None

    def test_an_event_is_written_once(self, database):
        run = runs.create_run(database, SPEC)
        assert runs.append_event(database, run.id, RunStarted(submission=1))
        assert not runs.append_event(database, run.id, RunStarted(submission=1))
        assert [e.seq for e in runs.events_of(database, run.id)] == [1, 2]

    def test_the_state_is_the_fold_of_the_events(self, database):
        run = runs.create_run(database, SPEC)
        failed = RunFailed(submission=1, code="worker_lost", message="gone")
        story = [RunStarted(submission=1), failed, RunQueued(submission=2)]
        story += [RunStarted(submission=2), RunStopped(submission=2), RunSucceeded()]
        for event in story:
            runs.append_event(database, run.id, event)
            events = [e.event for e in runs.events_of(database, run.id)]
            assert runs.get_run(database, run.id).state == state_after(events)

    def test_a_failure_has_its_error_until_the_run_goes_on(self, database):
        run = runs.create_run(database, SPEC)
        runs.append_event(database, run.id, RunFailed(submission=1, code="x", message="why"))
        record = runs.get_run(database, run.id)
        assert (record.error_code, record.error_message) == ("x", "why")
        again = runs.resubmit(database, run.id)
        assert (again.state, again.submission, again.error_code) == ("queued", 2, None)

    def test_impossible_rows_are_refused_by_the_database_itself(self, database):
        run = runs.create_run(database, SPEC)
        for change in ("state = 'sleeping'", "state = 'failed'", "submission = 0"):
            with pytest.raises(IntegrityError), database.write("test") as session:
                session.execute(text(f"update runs set {change} where id = '{run.id}'"))  # noqa: S608

    def test_pages_follow_the_order_of_submission(self, database):
        ids = [runs.create_run(database, SPEC).id for _ in range(5)]
        first = runs.list_runs(database, limit=2)
        rest = runs.list_runs(database, after=first[-1].number)
        assert [r.id for r in first + rest] == ids

    def test_a_benchmark_is_stored_with_all_its_runs(self, database):
        spec = BenchmarkSpec.model_validate(
            {"tasks": ["arm"], "methods": ["simopt"], "seeds": [0, 1], "preset": "smoke"}
        )
        record = runs.create_benchmark(database, spec)
        assert runs.get_benchmark(database, record.id) == record
        assert [r.spec for r in runs.runs_of(database, record.id)] == list(spec.runs())

    def test_a_large_benchmark_takes_no_more_statements_than_a_small_one(self, file_database):
        """5,000 runs held the lock for 12 seconds, statement by statement."""
        given = {"tasks": ["arm"], "methods": ["simopt"], "preset": "smoke"}
        counts = []
        for seeds in (1, 40):
            spec = BenchmarkSpec.model_validate({**given, "seeds": list(range(seeds))})
            with statements() as executed:
                id = runs.create_benchmark(file_database, spec).id
            counts.append(len(executed))
            with statements() as executed:
                runs.extend_benchmark(file_database, id, BenchmarkExtension(seeds=[1000 + seeds]))
            counts.append(len(executed))
        assert counts[:2] == counts[2:]

    def test_all_runs_of_a_benchmark_that_stopped_are_queued_again_in_batches(
        self, database, monkeypatch
    ):
        monkeypatch.setattr(runs, "_AT_ONCE", 2)
        given = {"tasks": ["arm"], "methods": ["simopt"], "preset": "smoke", "seeds": [0, 1]}
        id = runs.create_benchmark(database, BenchmarkSpec.model_validate(given)).id
        *stopped, done = runs.runs_of(database, id)
        assert {run.id for run in runs.request_cancel_all(database, id)} == {
            run.id for run in [*stopped, done]
        }
        runs.append_event(database, done.id, RunSucceeded())
        for batch in runs.batches([(run.id, RunStopped(submission=1)) for run in stopped]):
            runs.append_events(database, batch)
        queued = list(runs.resubmit_all(database, id))
        assert [run.id for run in queued] == [run.id for run in stopped]
        assert {(run.state, run.submission, run.cancel_requested) for run in queued} == {
            ("queued", 2, False)
        }
        assert list(runs.resubmit_all(database, id)) == []

    def test_a_benchmark_is_deleted_whole_and_only_when_finished(self, database):
        spec = BenchmarkSpec.model_validate(
            {"tasks": ["arm"], "methods": ["simopt"], "seeds": [0], "preset": "smoke"}
        )
        benchmark = runs.create_benchmark(database, spec)
        with pytest.raises(NotPossible, match="not finished"):
            runs.delete_benchmark(database, benchmark.id)
        for run in runs.runs_of(database, benchmark.id):
            runs.append_event(database, run.id, RunSucceeded())
            with pytest.raises(NotPossible, match="delete the benchmark"):
                runs.delete_run(database, run.id)
        runs.delete_benchmark(database, benchmark.id)
        assert [count(database, t) for t in ("benchmarks", "runs", "events")] == [0, 0, 0]

    def test_a_benchmark_grows_by_what_it_has_not(self, database):
        given = {"tasks": ["arm"], "methods": ["udr"], "seeds": [0], "preset": "smoke"}
        id = runs.create_benchmark(database, BenchmarkSpec.model_validate(given)).id
        before = runs.runs_of(database, id)
        added = runs.extend_benchmark(
            database, id, BenchmarkExtension.model_validate({"seeds": [1], "methods": ["droid"]})
        )
        assert runs.runs_of(database, id) == [*before, *added]
        cells = [(run.spec.method.name, run.spec.seed) for run in added]
        names = ("udr", "droid", "prior", "oracle")
        assert cells == [("droid", 0), *((name, 1) for name in names)]
        assert runs.get_benchmark(database, id).spec.seeds == [0, 1]
        for refused, message in (({"seeds": [1]}, "must not repeat"), ({}, "nothing to add")):
            with pytest.raises(InvalidInput, match=message):
                runs.extend_benchmark(database, id, BenchmarkExtension.model_validate(refused))
        assert len(runs.runs_of(database, id)) == len(before) + len(added)

    def test_a_benchmark_does_not_grow_by_runs_of_another_budget(self, database, monkeypatch):
        given = {"tasks": ["arm"], "methods": ["udr"], "seeds": [0], "preset": "smoke"}
        id = runs.create_benchmark(database, BenchmarkSpec.model_validate(given)).id
        monkeypatch.setitem(PRESETS["smoke"]["run"], "transitions", 30)
        with pytest.raises(NotPossible, match="differ from those it has in transitions"):
            runs.extend_benchmark(database, id, BenchmarkExtension.model_validate({"seeds": [1]}))

    def test_the_latest_come_first(self, database):
        ids = [runs.create_run(database, SPEC).id for _ in range(3)]
        assert [run.id for run in runs.latest(database, 2)[1]] == ids[:0:-1]

    def test_what_is_not_there_is_said_so(self, database):
        with pytest.raises(NotFound, match="no run 'run_x'"):
            runs.get_run(database, "run_x")
        with pytest.raises(NotFound, match="no benchmark 'b'"):
            runs.runs_of(database, "b")

    def test_only_live_runs_are_cancelled_and_only_ended_ones_resumed_or_deleted(self, database):
        run = runs.create_run(database, SPEC)
        with pytest.raises(NotPossible, match="only a failed or cancelled run"):
            runs.resubmit(database, run.id)
        with pytest.raises(NotPossible, match="cancel it before"):
            runs.delete_run(database, run.id)
        assert runs.request_cancel(database, run.id).cancel_requested
        runs.append_event(database, run.id, RunSucceeded())
        with pytest.raises(NotPossible, match="only a live run"):
            runs.request_cancel(database, run.id)


class TestStages:
    result = StageResult({"returns": [0.1, 1 / 3]}, {"policy": b"\0bytes", "data": b""})

    def test_a_result_comes_back_to_the_last_digit(self, database):
        run = runs.create_run(database, SPEC)
        assert found(database, STAGE.digest) is None
        commit(database, STAGE, self.result, run.id)
        assert found(database, STAGE.digest) == self.result

    def test_a_stage_is_committed_once_and_tells_every_run(self, database):
        first, second = (runs.create_run(database, SPEC) for _ in range(2))
        commit(database, STAGE, self.result, first.id)
        commit(database, STAGE, StageResult({"other": 1}), first.id, second.id)
        assert found(database, STAGE.digest) == self.result
        for run in (first, second):
            assert len(runs.events_of(database, run.id, type="stage_finished")) == 1

    def test_nothing_of_a_commit_stays_when_a_part_of_it_fails(self, database):
        with pytest.raises(NotFound):
            commit(database, STAGE, self.result, "run_that_is_not_there")
        assert [count(database, t) for t in ("stages", "artifacts", "events")] == [0, 0, 0]

    def test_equal_bytes_are_stored_once(self, database):
        run = runs.create_run(database, SPEC)
        for x in (1, 2):
            commit(database, Stage("evaluate", {"x": x}), StageResult({}, {"p": b"same"}), run.id)
        assert count(database, "artifacts") == 1

    def test_deleting_a_run_frees_what_only_it_refers_to(self, database):
        first, second = (runs.create_run(database, SPEC) for _ in range(2))
        commit(database, STAGE, self.result, first.id, second.id)
        own = Stage("evaluate", {"x": 2})
        commit(database, own, StageResult({}, {"p": b"own"}), first.id)
        for run in (first, second):
            runs.append_event(database, run.id, RunSucceeded())
        runs.delete_run(database, first.id)
        assert found(database, own.digest) is None
        assert found(database, STAGE.digest) == self.result
        runs.delete_run(database, second.id)
        tables = ("runs", "events", "stages", "artifacts", "stage_artifacts")
        assert [count(database, table) for table in tables] == [0] * 5

    def test_how_long_it_took_is_kept_beside_it(self, database):
        run = runs.create_run(database, SPEC)
        commit(database, STAGE, self.result, run.id)
        assert stages.timings_of(database, [run.id]) == [("evaluate", TIMING)]
        now = datetime.now(UTC).timestamp()
        recent = replace(TIMING, placed=now - 2, began=now - 1, ended=now)
        other = Stage("evaluate", {"x": 3})
        with database.write("test") as session:
            document, execution = canonical_json(other.document), replace(EXECUTION, timing=recent)
            stages.add_result(session, other.digest, document, self.result, execution)
        assert stages.timings_between(database, now - 1, now) == [recent]
        assert stages.timings_between(database, now - 9, now - 3) == []
        assert stages.seconds_of(database, [STAGE.digest]) == {STAGE.digest: 0.5}

    def test_the_best_policy_so_far_can_be_had_until_there_is_the_final_one(self, database):
        run = runs.create_run(database, SPEC)
        for steps, policy in ((10, b"poor"), (20, b"better"), (30, b"better")):
            with database.write("test") as session:
                stages.note_checkpoint(session, STAGE.digest, steps, policy)
            assert stages.policy_of_training(database, STAGE.digest) == policy
            assert count(database, "artifacts") == 1
        with database.write("test") as session:  # its process was lost, and it starts again
            stages.note_checkpoint(session, STAGE.digest, 10, b"poor")
        assert stages.policy_of_training(database, STAGE.digest) == b"better"
        commit(database, STAGE, StageResult({}, {"policy": b"best"}), run.id)
        assert stages.policy_of_training(database, STAGE.digest) == b"best"
        with database.write("test") as session:  # it comes late
            stages.note_checkpoint(session, STAGE.digest, 40, b"better")
        assert [count(database, t) for t in ("checkpoints", "artifacts")] == [0, 1]

    def test_a_policy_so_far_stays_as_long_as_a_run_speaks_of_it(self, database):
        """A training that was cancelled has no more than that."""
        one, other = (runs.create_run(database, SPEC) for _ in range(2))
        point = TrainingEvaluated(
            digest=STAGE.digest, steps=10, mean_return=1.0, standard_error=0.1
        )
        with database.write("test") as session:
            stages.note_checkpoint(session, STAGE.digest, 10, b"so far")
            runs.append(session, one.id, point)
        for run, left in ((other, 1), (one, 0)):
            runs.append_event(database, run.id, RunSucceeded())
            runs.delete_run(database, run.id)
            assert [count(database, t) for t in ("checkpoints", "artifacts")] == [left, left]


class TestKeptResults:
    def test_a_table_is_kept_for_its_version_until_the_run_goes(self, database):
        run = runs.create_run(database, SPEC)
        assert runs.kept_results(database, run.id, "one") is None
        for version, body in (("one", "first"), ("two", "second")):
            runs.keep_results(database, run.id, version, body)
            assert runs.kept_results(database, run.id, version) == body
        assert runs.kept_results(database, run.id, "one") is None
        runs.append_event(database, run.id, RunSucceeded())
        runs.delete_run(database, run.id)
        assert count(database, "results") == 0

    def test_a_benchmarks_tables_go_with_it(self, database):
        spec = BenchmarkSpec.model_validate(
            {"tasks": ["arm"], "methods": ["simopt"], "seeds": [0], "preset": "smoke"}
        )
        benchmark = runs.create_benchmark(database, spec)
        (run, *_) = members = runs.runs_of(database, benchmark.id)
        for member in members:
            runs.append_event(database, member.id, RunSucceeded())
        for id in (benchmark.id, run.id):
            runs.keep_results(database, id, "one", "table")
        runs.delete_benchmark(database, benchmark.id)
        assert count(database, "results") == 0


class TestRetention:
    def test_what_ended_before_is_found_and_what_lives_or_is_recent_is_not(self, database):
        spec = BenchmarkSpec.model_validate(
            {"tasks": ["arm"], "methods": ["simopt"], "seeds": [0, 1], "preset": "smoke"}
        )
        whole, half = (runs.create_benchmark(database, spec).id for _ in range(2))
        ended, live = (runs.create_run(database, SPEC).id for _ in range(2))
        members = [run.id for run in runs.runs_of(database, whole)]
        for id in [*members, *(run.id for run in runs.runs_of(database, half)[1:]), ended]:
            runs.append_event(database, id, RunSucceeded())
        later = datetime.now(UTC)
        expected = [(runs.delete_benchmark, whole), (runs.delete_run, ended)]
        assert runs.finished_before(database, later) == expected
        assert runs.finished_before(database, later - timedelta(hours=1)) == []
        for delete, id in expected:
            delete(database, id)
        left = {run.id for run in runs.list_runs(database)}
        assert left == {run.id for run in runs.runs_of(database, half)} | {live}


class TestSession:
    def test_what_is_committed_is_on_disk_for_any_other_reader(self, file_database, tmp_path):
        run = runs.create_run(file_database, SPEC)
        with sqlite3.connect(tmp_path / "adr.sqlite") as other:
            assert other.execute("select id from runs").fetchall() == [(run.id,)]
        other.close()

    def test_the_writer_waits_for_the_disk(self, file_database):
        with file_database.write("test") as session:
            assert session.scalar(text("pragma journal_mode")) == "wal"
            assert session.scalar(text("pragma synchronous")) == 2  # FULL
            assert session.scalar(text("pragma foreign_keys")) == 1

    def test_a_reader_cannot_write(self, database):
        refused = pytest.raises(DBAPIError, match=r"readonly|read-only transaction")
        with refused, database.read() as session:
            session.execute(text("delete from runs"))

    def test_a_reader_sees_one_moment(self, database):
        with database.read() as session:
            assert session.scalar(text("select count(*) from runs")) == 0
            runs.create_run(database, SPEC)
            assert session.scalar(text("select count(*) from runs")) == 0
        assert count(database, "runs") == 1

    def test_a_lock_of_another_process_and_a_full_disk_are_told_apart_from_defects(
        self, tmp_path, monkeypatch
    ):
        monkeypatch.setattr("db.backends.BUSY_TIMEOUT_MS", 50)
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
    def test_files_that_go_away_under_a_service_stop_its_writes(
        self, file_database, tmp_path, file, how
    ):
        runs.create_run(file_database, SPEC)
        (tmp_path / file).rename(tmp_path / "elsewhere")
        if how == "replaced":
            shutil.copy(tmp_path / "elsewhere", tmp_path / file)
        with pytest.raises(DatabaseGone, match=rf"{file} was deleted or replaced"):
            runs.create_run(file_database, SPEC)

    def test_a_log_without_its_database_is_not_thrown_away(self, tmp_path):
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
        (killed / "moved").rename(killed / "adr.sqlite")
        with closing(open_database(url)) as database:
            assert runs.get_run(database, run.id) == run

    def test_no_file_beside_the_database_holds_its_lock(self, file_database, tmp_path):
        for file in tmp_path.glob("adr.sqlite?lock*"):
            file.unlink()
        with pytest.raises(DatabaseInUse):
            Database(file_database.url)

    def test_a_new_database_is_readable_by_its_owner_alone(self, tmp_path):
        tmp_path.chmod(0o755)
        with closing(open_database(f"sqlite:///{tmp_path / 'x.sqlite'}")) as database:
            runs.create_run(database, SPEC)
            modes = {f.name: stat.S_IMODE(f.stat().st_mode) for f in tmp_path.glob("x.sqlite*")}
        assert modes == dict.fromkeys(("x.sqlite", "x.sqlite-wal", "x.sqlite-shm"), 0o600)

    def test_deleting_gives_disk_space_back(self, tmp_path):
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
        self, tmp_path, monkeypatch
    ):
        nothing = SimpleNamespace(free=0)
        monkeypatch.setattr("db.backends.shutil.disk_usage", lambda _: nothing)
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

    def test_no_update_is_lost_between_threads(self, database):
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

    def test_a_second_service_on_the_same_file_is_refused(self, database):
        with pytest.raises(DatabaseInUse, match="in use by another service"):
            open_database(database.url)

    @pytest.mark.parametrize("url", ["sqlite://", "sqlite:///:memory:", "mysql://a:secret@b/c"])
    def test_other_databases_are_refused(self, url):
        with pytest.raises(InvalidInput, match="must be an SQLite file") as refused:
            open_database(url)
        assert "secret" not in str(refused.value)

    def test_after_closing_it_is_free(self, database):
        database.close()
        open_database(database.url).close()


class TestPostgresql:
    """What only a server can do to us."""

    @pytest.fixture
    def url(self, postgresql):
        return postgresql.new_database()

    def test_a_lost_connection_comes_back_and_keeps_others_away(self, url, postgresql):
        with closing(open_database(url)) as database:
            run = runs.create_run(database, SPEC)
            postgresql.cut(url)
            assert runs.get_run(database, run.id) == run
            runs.create_run(database, SPEC)
            with pytest.raises(DatabaseInUse, match="in use by another service"):
                open_database(url)

    def test_who_lost_the_lock_to_another_cannot_write_any_more(self, url, postgresql):
        with closing(open_database(url)) as database:
            postgresql.cut(url)
            with closing(open_database(url)) as second:
                runs.create_run(second, SPEC)
                with pytest.raises(DatabaseInUse):
                    runs.create_run(database, SPEC)
                assert count(database, "runs") == 1
            runs.create_run(database, SPEC)  # the other has gone
            assert count(database, "runs") == 2

    def test_a_connection_lost_in_a_transaction_stores_nothing_of_it(self, url, postgresql):
        with closing(open_database(url)) as database:
            lost = pytest.raises(DatabaseUnavailable, match="cannot be used just now")
            with lost, database.write("test") as session:
                stages.add_artifact(session, b"policy")
                postgresql.cut(url)
                stages.add_artifact(session, b"another")
            assert count(database, "artifacts") == 0

    def test_a_server_that_takes_no_writes_any_more_is_waited_for(self, url, postgresql):
        with closing(open_database(url)) as database:
            run = runs.create_run(database, SPEC)
            with postgresql.read_only():
                # on the connection that there was, and on a new one, which may find another server
                for told in ("cannot execute INSERT", "session is read-only"):
                    with pytest.raises(DatabaseUnavailable, match=told):
                        runs.create_run(database, SPEC)
                assert runs.get_run(database, run.id) == run
            runs.create_run(database, SPEC)
            assert count(database, "runs") == 2

    def test_what_it_cannot_store_is_the_givers_fault(self, url):
        with closing(open_database(url)) as database:
            with pytest.raises(InvalidInput, match="cannot store this"):
                runs.list_runs(database, task="hop\0per")
            with pytest.raises(InvalidInput, match="too long"), database.write("test") as session:
                session.add(ResultsRow(id="x" * 41, version="", body=""))

    def test_options_of_the_url_count_for_tables_and_rows(self, url, postgresql):
        with closing(Database(url)) as database, database.write("test") as session:
            session.execute(text("create schema s"))
        with closing(open_database(f"{url}&options=-csearch_path%3Ds")) as database:
            runs.create_run(database, SPEC)
            assert count(database, "s.runs") == 1

    @pytest.mark.parametrize("given", ["what?", "postgresql+psycopg://me:secret@[::1/adr"])
    def test_a_url_that_is_none_is_said_without_its_password(self, given):
        with pytest.raises(InvalidInput, match="must be an SQLite file") as told:
            open_database(given)
        assert "secret" not in str(told.value)

    def test_a_server_that_is_not_there_is_said(self):
        with pytest.raises(DatabaseUnavailable, match="cannot be used just now") as told:
            open_database("postgresql+psycopg://me:secret@127.0.0.1:9/adr")
        assert "secret" not in str(told.value)

    def test_upkeep_is_the_servers(self, url, monkeypatch):
        monkeypatch.setenv("ADR_DATABASE_URL", url)
        refused = CliRunner().invoke(app, ["db", "check"])
        assert "pg_dump" in str(refused.exception)


class TestMigrations:
    def test_they_lead_to_the_tables_of_the_models(self, database):
        """`alembic check` finds nothing to add."""
        database.close()
        command.check(alembic_config(database.url))

    def test_rows_survive_the_way_from_the_first_tables(self, database_url):
        """The second recreates `runs` in SQLite, whose deletion would take the events along."""
        command.upgrade(alembic_config(database_url), "0001")
        row = {"spec": SPEC.model_dump_json(), "now": "2026-01-01 00:00:00", "no": False}
        event = RunQueued(submission=1)
        values = {"key": event.key, "type": event.type, "body": event.model_dump_json()}
        with closing(Database(database_url)) as old, old.write("test") as session:
            session.execute(
                text(
                    "insert into runs (id, created_at, updated_at, task, variant, method, seed, "
                    "spec, state, submission, cancel_requested) values ('run_a', :now, :now, "
                    "'arm', 'vanilla', 'prior', 0, :spec, 'queued', 1, :no)"
                ),
                row,
            )
            session.execute(
                text("insert into events values ('run_a', 1, :key, :type, :body, :now)"),
                {**values, "now": row["now"]},
            )
        with closing(open_database(database_url)) as opened:
            assert runs.get_run(opened, "run_a").spec == SPEC
            assert [e.event for e in runs.events_of(opened, "run_a")] == [event]

    def test_before_an_upgrade_the_file_is_copied(self, tmp_path):
        url = f"sqlite:///{tmp_path / 'old.sqlite'}"
        command.upgrade(alembic_config(url), "0002")
        for _ in range(2):  # the second time there is nothing to upgrade
            open_database(url).close()
            (copy,) = tmp_path.glob("old.sqlite.0002.*.bak")
        assert maintenance.revision_of(copy) == "0002"
        assert maintenance.revision_of(tmp_path / "old.sqlite") == "0005"

    def test_a_failed_upgrade_leaves_the_file_and_no_copy(self, tmp_path):
        url = f"sqlite:///{tmp_path / 'old.sqlite'}"
        command.upgrade(alembic_config(url), "0003")
        with closing(sqlite3.connect(tmp_path / "old.sqlite")) as other, other:
            other.execute("create table target_tasks (mine integer)")
            other.execute("insert into target_tasks values (1)")
        for _ in range(3):
            with pytest.raises(DatabaseDamaged, match="left rows in target_tasks"):
                open_database(url)
        assert not list(tmp_path.glob("*.bak*"))
        assert maintenance.revision_of(tmp_path / "old.sqlite") == "0003"

    @pytest.mark.parametrize("revision", [None, "0001", "0003"])
    def test_a_kill_at_any_statement_of_an_upgrade_leaves_a_database_that_opens(
        self, tmp_path, revision
    ):
        """Copies of the files before every statement are what kill -9 would leave there."""
        path, copies = tmp_path / "adr.sqlite", []
        if revision is not None:
            command.upgrade(alembic_config(f"sqlite:///{path}"), revision)
            with closing(sqlite3.connect(path)) as other, other:
                other.execute(*AN_ARTIFACT)

        def keep_a_copy(*_):
            folder = tmp_path / f"copy{len(copies)}"
            folder.mkdir()
            for file in tmp_path.glob("adr.sqlite*"):
                shutil.copy(file, folder)
            copies.append(folder)

        engine_event.listen(Engine, "before_cursor_execute", keep_a_copy)
        try:
            open_database(f"sqlite:///{path}").close()
        finally:
            engine_event.remove(Engine, "before_cursor_execute", keep_a_copy)
        assert len(copies) > 5
        for folder in copies:
            with closing(open_database(f"sqlite:///{folder / 'adr.sqlite'}")) as opened:
                assert count(opened, "artifacts") == (0 if revision is None else 1)
                assert opened.revision() == head()

    @pytest.mark.parametrize("revision", [None, "0003"])
    def test_what_upgrades_of_earlier_versions_left_half_done_is_cleared_away(
        self, tmp_path, revision
    ):
        """The tables of 0004, with the revision still at the one before."""
        path = tmp_path / "adr.sqlite"
        url = f"sqlite:///{path}"
        command.upgrade(alembic_config(url), "0004")
        with closing(sqlite3.connect(path)) as other, other:
            other.execute("delete from alembic_version")
            if revision is not None:
                other.execute("insert into alembic_version values (?)", (revision,))
                other.execute(*AN_ARTIFACT)
        assert "the table target_tasks is of a later revision" in "".join(
            maintenance.unfinished(path)
        )
        with closing(open_database(url)) as opened:
            assert opened.revision() == head()
            assert count(opened, "artifacts") == (0 if revision is None else 1)
        assert maintenance.check(path) == []

    @pytest.mark.parametrize("lacking", [["results"], ["results", "requests"]])
    def test_databases_of_earlier_forms_of_0004_are_made_whole(self, tmp_path, lacking):
        path = tmp_path / "adr.sqlite"
        url = f"sqlite:///{path}"
        command.upgrade(alembic_config(url), "0004")
        with closing(sqlite3.connect(path)) as other, other:
            for table in lacking:
                other.execute(f"drop table {table}")
            other.execute("drop index ix_runs_task_method")
        told = CliRunner().invoke(app, ["db", "check", "--data-dir", str(tmp_path)])
        assert "the table results is missing" in str(told.exception)
        with closing(open_database(url)) as opened:
            runs.keep_results(opened, "run_a", "1", "{}")
        command.check(alembic_config(url))
        assert maintenance.check(path) == maintenance.unfinished(path) == []

    @pytest.mark.parametrize("before_the_old_one_went", [True, False])
    def test_a_table_that_was_being_rebuilt_is_no_riddle(self, tmp_path, before_the_old_one_went):
        """0002 rebuilds `runs`; versions before this one could be killed half-way."""
        path = tmp_path / "adr.sqlite"
        command.upgrade(alembic_config(f"sqlite:///{path}"), "0001")
        with closing(sqlite3.connect(path)) as other, other:
            other.execute("create table _alembic_tmp_runs as select * from runs")
            if not before_the_old_one_went:
                other.execute("drop table runs")
        if before_the_old_one_went:
            open_database(f"sqlite:///{path}").close()
        else:
            with pytest.raises(DatabaseDamaged, match=r"rebuilt the table runs; restore the copy"):
                open_database(f"sqlite:///{path}")

    def test_a_killed_upgrade_leaves_one_copy_however_often_it_is_killed(self, tmp_path):
        url = f"sqlite:///{tmp_path / 'old.sqlite'}"
        command.upgrade(alembic_config(url), "0003")
        script = f"from db.session import open_database; open_database({url!r})"
        for name in ("migration_0004", "migration_0005", "upgrade:before"):
            killed = subprocess.run(
                [sys.executable, "-c", script],
                env={**os.environ, "ADR_FAILPOINT": name},
                check=False,
                cwd=Path(schema.__file__).parents[1],
            )
            assert killed.returncode == 137, name
            (copy,) = tmp_path.glob("*.bak")
            assert maintenance.revision_of(copy) == "0003"
            assert maintenance.revision_of(tmp_path / "old.sqlite") == "0003"
        open_database(url).close()
        (copy,) = tmp_path.glob("*.bak")
        assert "upgrading" not in copy.name

    def test_a_released_migration_is_never_edited(self):
        """A database that it has made already would not get what was added."""
        known = {
            "0001": "5323830174ba0457ca84de6ad0961ee5",
            "0002": "b2d69612c7aa6fe1098907353dcaeb5d",
            "0003": "13ebde8e0765f1d805528df8af13bd4a",
            "0004": "f9455c8c1f54f6ec906ef9a9b2d4f08a",
            "0005": "0adbfbede86b6497ea2993d4a7101791",
        }
        files = Path(schema.__file__).parent.glob("migrations/versions/*.py")
        assert {file.name[:4]: sha256(file.read_bytes())[:32] for file in files} == known

    def test_a_database_of_a_later_version_is_left_as_it_is(self, database):
        with database.write("test") as session:
            session.execute(text("update alembic_version set version_num = '0999'"))
        database.close()
        with pytest.raises(DatabaseNewer, match="revision 0999, which this version does not know"):
            open_database(database.url)
        with closing(Database(database.url)) as later:
            assert later.revision() == "0999"
        if database.url.startswith("sqlite"):
            (line,) = maintenance.unfinished(Path(database.url.removeprefix("sqlite:///")))
            assert line == "revision 0999 is of a later version of the service"

    def test_they_go_down_to_nothing_and_up_again(self, database):
        config = alembic_config(database.url)
        database.close()
        command.downgrade(config, "base")
        command.upgrade(config, "head")
        reopened = open_database(database.url)
        with reopened.read() as session:
            assert "runs" in inspect(session.connection()).get_table_names()
        reopened.close()


class TestUpkeep:
    """`adr db`, beside a service that has the database open."""

    @pytest.fixture
    def database(self, file_database):
        return file_database

    def adr(self, tmp_path, *arguments):
        return CliRunner().invoke(app, ["db", *arguments, "--data-dir", str(tmp_path)])

    def test_what_is_sound_is_said_to_be(self, database, tmp_path):
        runs.create_run(database, SPEC)
        told = self.adr(tmp_path, "check").output.replace("\n", "")
        assert "is sound: 0 benchmarks, 1 runs, 1 events" in told

    def test_damage_is_found(self, database, tmp_path):
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
        failed = self.adr(tmp_path, "check")
        assert isinstance(failed.exception, upkeep.Damaged)

    def test_a_backup_has_everything_and_overwrites_nothing(self, database, tmp_path):
        run = runs.create_run(database, SPEC)
        copy = tmp_path / "copy.sqlite"
        assert self.adr(tmp_path, "backup", str(copy)).exit_code == 0
        runs.create_run(database, SPEC)  # not in it
        with closing(open_database(f"sqlite:///{copy}")) as restored:
            assert runs.get_run(restored, run.id) == run
            assert count(restored, "runs") == 1
        with pytest.raises(InvalidInput, match="is there already"):
            maintenance.backup(tmp_path / "adr.sqlite", copy)
        with pytest.raises(InvalidInput, match=r"could not be copied to .*nowhere"):
            maintenance.backup(tmp_path / "adr.sqlite", tmp_path / "nowhere" / "copy.sqlite")

    def test_a_backup_is_put_in_the_place_of_what_is_damaged(self, tmp_path):
        path, copy = tmp_path / "adr.sqlite", tmp_path / "copy.sqlite"
        with closing(open_database(f"sqlite:///{path}")) as database:
            run = runs.create_run(database, SPEC)
            maintenance.backup(path, copy)
            in_use = self.adr(tmp_path, "restore", str(copy))
            assert isinstance(in_use.exception, DatabaseInUse)
        with closing(Sessions(tmp_path)):  # of a service whose database was deleted
            in_use = self.adr(tmp_path, "restore", str(copy))
            assert "a service runs in" in str(in_use.exception)
        path.write_bytes(b"what?")
        assert "is copy.sqlite now" in self.adr(tmp_path, "restore", str(copy)).output.replace(
            "\n", ""
        ).replace(str(tmp_path) + "/", "")
        with closing(open_database(f"sqlite:///{path}")) as database:
            assert runs.get_run(database, run.id) == run
        (aside,) = tmp_path.glob("adr.sqlite.*.replaced")
        assert aside.read_bytes() == b"what?"
        assert stat.S_IMODE(path.stat().st_mode) == 0o600
        copy.write_bytes(b"what?")
        assert "cannot be read" in str(self.adr(tmp_path, "restore", str(copy)).exception)

    @pytest.mark.parametrize("page", range(1, 40, 3))
    def test_a_hole_in_the_file_is_called_damage_by_check_and_by_the_service(self, tmp_path, page):
        path = tmp_path / "adr.sqlite"
        with closing(open_database(f"sqlite:///{path}")) as database:
            for _ in range(40):
                runs.create_run(database, SPEC)
        with path.open("r+b") as file:
            file.seek(4096 * page)
            file.write(bytes(4096))
        failed = self.adr(tmp_path, "check")
        assert isinstance(failed.exception, upkeep.Damaged), failed.output
        assert "restore a backup" in str(failed.exception)
        try:
            with closing(open_database(f"sqlite:///{path}")) as database:
                runs.unfinished_runs(database)
                for run in runs.list_runs(database):
                    runs.events_of(database, run.id)
                runs.create_run(database, SPEC)
        except AdrError as error:
            assert "damaged" in str(error)  # noqa: PT017 - some pages are of no use to these

    def test_what_is_no_database_is_said(self, tmp_path):
        with pytest.raises(InvalidInput, match="there is no database"):
            maintenance.check(tmp_path / "adr.sqlite")
        (tmp_path / "adr.sqlite").write_text("a letter, and not a short one at all" * 20)
        with pytest.raises(InvalidInput, match="cannot be read as a database"):
            maintenance.check(tmp_path / "adr.sqlite")

    def test_an_older_database_is_upgraded(self, tmp_path):
        command.upgrade(alembic_config(f"sqlite:///{tmp_path / 'adr.sqlite'}"), "0001")
        assert "is sound" in self.adr(tmp_path, "check").output.replace("\n", "")
        told = self.adr(tmp_path, "upgrade").output.replace("\n", "")
        assert told.endswith("revision 0001 -> 0005")


class TestDatasets:
    def test_equal_bytes_are_one_dataset(self, database):
        content = a_recording()
        record, is_new = datasets.store_dataset(database, content)
        assert is_new
        assert datasets.store_dataset(database, content) == (record, False)
        assert datasets.load_dataset(database, record.id) == (record, content)
        assert (record.transitions, record.episodes, record.actions) == (4, 2, 2)
        assert datasets.list_datasets(database) == [record]

    def test_one_that_a_run_learns_from_stays(self, database):
        record, _ = datasets.store_dataset(database, a_recording())
        target = {"kind": "recorded", "dataset": record.id}
        spec = {"task": "arm", "method": "droid", "preset": "smoke", "target": target}
        run = runs.create_run(database, RunSpec.model_validate(spec))
        with pytest.raises(NotPossible, match=f"{run.id} learns from {record.id}"):
            datasets.delete_dataset(database, record.id)
        runs.append_event(database, run.id, RunFailed(submission=1, code="x", message="y"))
        runs.delete_run(database, run.id)
        assert datasets.load_dataset(database, record.id)[0] == record  # its bytes are still there
        datasets.delete_dataset(database, record.id)
        assert count(database, "artifacts") == 0
        with pytest.raises(NotFound, match="dataset"):
            runs.create_run(database, RunSpec.model_validate(spec))


def a_recording():
    rows = np.arange(16.0).reshape(4, 4)
    episodes, columns = np.array([0, 0, 1, 1]), tuple("abcd")
    return TransitionDataset(rows, rows[:, :2], rows, episodes, 0.02, columns, "test").to_npz()
