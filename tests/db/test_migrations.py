"""Migrations: whole or not at all, from every earlier form."""

import json
import os
import shutil
import sqlite3
import subprocess
import sys
from contextlib import closing
from pathlib import Path

import pytest
from alembic import command
from sqlalchemy import Engine, inspect, text
from sqlalchemy import event as engine_event
from typer.testing import CliRunner

from adr_service.events import RunQueued
from adr_service.json_values import sha256
from adr_service.specs import BenchmarkExtension, RunSpec
from adr_service.training.settings import PpoSettings, SacSettings
from api.cli import app
from db import benchmarks, events, maintenance, results, runs, schema
from db.errors import DatabaseDamaged, DatabaseNewer
from db.schema import alembic_config, head
from db.session import Database, open_database
from tests.db.rows import SPEC, count

AN_ARTIFACT = "insert into artifacts values (?, 1, x'00')", (sha256(bytes(1)),)


def test_migrations_make_the_tables_of_the_models(database):
    """`alembic check` finds nothing to add."""
    database.close()
    command.check(alembic_config(database.url))


def test_rows_survive_all_migrations(database_url):
    """The second recreates `runs` in SQLite, whose deletion would take the events along."""
    command.upgrade(alembic_config(database_url), "0001")
    event = RunQueued(submission=1)
    values = {"key": event.key, "type": event.type, "body": event.model_dump_json()}
    with closing(Database(database_url)) as old, old.write("test") as session:
        _insert_run(session, SPEC.model_dump(mode="json"))
        session.execute(
            text("insert into events values ('run_a', 1, :key, :type, :body, :now)"),
            {**values, "now": "2026-01-01 00:00:00"},
        )
    with closing(open_database(database_url)) as opened:
        assert runs.get_run(opened, "run_a").spec == SPEC
        assert [e.event for e in events.events_of(opened, "run_a")] == [event]


def test_specs_from_before_the_choice_of_an_algorithm_keep_their_sac(database_url):
    """The preset quick has trained by PPO since, and SAC's settings are not PPO's."""
    command.upgrade(alembic_config(database_url), "0005")
    given = {"task": "hopper", "method": "prior", "training": {"algorithm": "sac", "tau": 0.01}}
    old = RunSpec.model_validate(given).model_dump(mode="json")
    del old["training"]["algorithm"]
    grid = {"tasks": ["hopper"], "methods": ["udr"], "seeds": [7], "training": {"tau": 0.01}}
    with closing(Database(database_url)) as before, before.write("test") as session:
        _insert_benchmark(session, grid)
        _insert_run(session, old)
    with closing(open_database(database_url)) as opened:
        assert runs.get_run(opened, "run_a").spec == RunSpec.model_validate(given)
        for trained in _trainings_when_extended(opened):
            assert isinstance(trained, SacSettings)
            assert (trained.max_steps, trained.gradient_steps, trained.tau) == (120_000, 12, 0.01)


@pytest.mark.parametrize("backend", ["sb3", "sbx"])
def test_ppo_runs_from_before_the_choice_of_first_weights_name_their_librarys(
    database_url, backend
):
    """SB3's were orthogonal, SBX's were not; runs by other algorithms stay as they are."""
    command.upgrade(alembic_config(database_url), "0006")
    training = {"algorithm": "ppo", "backend": backend}
    given = {"task": "walker2d", "method": "prior", "preset": "fast", "training": training}
    old = RunSpec.model_validate(given).model_dump(mode="json")
    del old["training"]["ortho_init"]
    with closing(Database(database_url)) as before, before.write("test") as session:
        _insert_run(session, old)
        _insert_run(session, SPEC.model_dump(mode="json"), "run_b")
    with closing(open_database(database_url)) as opened:
        (ppo, other) = (runs.get_run(opened, id).spec for id in ("run_a", "run_b"))
        assert isinstance(ppo, RunSpec)
        assert isinstance(ppo.training, PpoSettings)
        assert ppo.training.ortho_init == (backend == "sb3")
        assert other == SPEC


@pytest.mark.parametrize(
    ("given", "expected"),
    [
        ({}, {"algorithm": "sac", "max_steps": 40_000, "gradient_steps": 6}),
        ({"tau": 0.01}, {"algorithm": "sac", "max_steps": 40_000, "tau": 0.01}),
        (
            {"algorithm": "crossq"},
            {"algorithm": "crossq", "max_steps": 40_000, "critic_hidden": [128, 128]},
        ),
        (
            {"algorithm": "ppo", "batch_size": 4096},
            {
                "max_steps": 40_000,
                "rollout_steps": 128,
                "hidden": [128, 128],
                "learning_rate": 5e-4,
            },
        ),
    ],
)
def test_benchmarks_from_before_the_demo_trained_by_ppo_keep_their_trainings(
    database_url, given, expected
):
    command.upgrade(alembic_config(database_url), "0006")
    grid = {"tasks": ["arm"], "methods": ["udr"], "seeds": [7], "preset": "demo", "training": given}
    with closing(Database(database_url)) as before, before.write("test") as session:
        _insert_benchmark(session, grid)
    with closing(open_database(database_url)) as opened:
        for trained in _trainings_when_extended(opened):
            assert trained.model_dump().items() >= expected.items()


@pytest.mark.parametrize(("exact", "search"), [(False, "trust_region"), (True, "cma_es")])
def test_runs_from_before_the_choice_of_a_search_name_theirs(database_url, exact, search):
    command.upgrade(alembic_config(database_url), "0007")
    given = {"task": "hopper", "method": {"name": "dropo", "search": search}}
    old = RunSpec.model_validate(given).model_dump(mode="json")
    del old["method"]["search"]
    old["method"]["exact"] = exact
    with closing(Database(database_url)) as before, before.write("test") as session:
        _insert_run(session, old)
        _insert_run(session, SPEC.model_dump(mode="json"), "run_b")
    with closing(open_database(database_url)) as opened:
        (dropo, other) = (runs.get_run(opened, id).spec for id in ("run_a", "run_b"))
        assert dropo == RunSpec.model_validate(given)
        assert other == SPEC


def test_benchmarks_from_before_the_full_covariance_keep_their_simopt(database_url):
    command.upgrade(alembic_config(database_url), "0007")
    methods = ["simopt", {"name": "simopt_1", "samples": 300}, "droid", "udr"]
    grid = {"tasks": ["hopper"], "methods": methods, "seeds": [7]}
    with closing(Database(database_url)) as before, before.write("test") as session:
        _insert_benchmark(session, grid)
    with closing(open_database(database_url)) as opened:
        runs_of = {run.method.name: run for run in _runs_when_extended(opened)}
        damped = runs_of["simopt"].method, runs_of["simopt_1"].method, runs_of["droid"].simopt
        assert [settings.covariance_damping for settings in damped] == [2, 2, 2]


def test_defaults_of_bayrn_and_droid_are_written_out_in_what_was_stored(database_url):
    command.upgrade(alembic_config(database_url), "0008")
    given = {"task": "hopper", "method": {"name": "bayrn", "report": "best"}}
    old = RunSpec.model_validate(given).model_dump(mode="json")
    del old["method"]["report"]
    grid = {"tasks": ["hopper"], "methods": ["bayrn", "droid"], "seeds": [7], "preset": "paper"}
    with closing(Database(database_url)) as before, before.write("test") as session:
        _insert_run(session, old)
        _insert_run(session, SPEC.model_dump(mode="json"), "run_b")
        _insert_benchmark(session, grid)
    with closing(open_database(database_url)) as opened:
        assert runs.get_run(opened, "run_a").spec == RunSpec.model_validate(given)
        assert runs.get_run(opened, "run_b").spec == SPEC
        found = {run.method.name: run.method for run in _runs_when_extended(opened)}
        assert (found["bayrn"].report, found["droid"].budget) == ("best", 1000)


def _insert_run(session, spec, id="run_a"):
    row = {"id": id, "spec": json.dumps(spec), "now": "2026-01-01 00:00:00", "no": False}
    session.execute(
        text(
            "insert into runs (id, created_at, updated_at, task, variant, method, seed, "
            "spec, state, submission, cancel_requested) values (:id, :now, :now, "
            "'hopper', 'vanilla', 'prior', 0, :spec, 'queued', 1, :no)"
        ),
        row,
    )


def _insert_benchmark(session, grid):
    session.execute(
        text(
            "insert into benchmarks (id, created_at, spec) "
            "values ('bench_a', '2026-01-01 00:00:00', :spec)"
        ),
        {"spec": json.dumps(grid)},
    )


def _trainings_when_extended(opened):
    """The trainings of the benchmark's runs, after another seed was added to it."""
    return [run.training for run in _runs_when_extended(opened)]


def _runs_when_extended(opened):
    wider = benchmarks.get_benchmark(opened, "bench_a").spec.extended(BenchmarkExtension(seeds=[8]))
    return list(wider.runs())


def test_before_an_upgrade_the_file_is_copied(tmp_path):
    url = f"sqlite:///{tmp_path / 'old.sqlite'}"
    command.upgrade(alembic_config(url), "0002")
    for _ in range(2):  # the second time there is nothing to upgrade
        open_database(url).close()
        (copy,) = tmp_path.glob("old.sqlite.0002.*.bak")
    assert maintenance.revision_of(copy) == "0002"
    assert maintenance.revision_of(tmp_path / "old.sqlite") == head()


def test_a_failed_upgrade_leaves_the_file_and_no_copy(tmp_path):
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
def test_a_kill_at_any_statement_of_an_upgrade_leaves_a_database_that_opens(tmp_path, revision):
    """Copies of the files before every statement are what kill -9 would leave there."""
    path, copies, statements = tmp_path / "adr.sqlite", {}, []
    if revision is not None:
        command.upgrade(alembic_config(f"sqlite:///{path}"), revision)
        with closing(sqlite3.connect(path)) as other, other:
            other.execute(*AN_ARTIFACT)

    def keep_a_copy(*_):
        files = sorted(tmp_path.glob("adr.sqlite*"))
        shared = "-shm"  # an index of the log, which SQLite makes anew
        content = tuple(sha256(f.read_bytes()) for f in files if not f.name.endswith(shared))
        statements.append(content)
        if content in copies:
            return
        copies[content] = folder = tmp_path / f"copy{len(copies)}"
        folder.mkdir()
        for file in files:
            shutil.copy(file, folder)

    engine_event.listen(Engine, "before_cursor_execute", keep_a_copy)
    try:
        open_database(f"sqlite:///{path}").close()
    finally:
        engine_event.remove(Engine, "before_cursor_execute", keep_a_copy)
    assert len(statements) > 5
    assert len(copies) > 1
    for folder in copies.values():
        with closing(open_database(f"sqlite:///{folder / 'adr.sqlite'}")) as opened:
            assert count(opened, "artifacts") == (0 if revision is None else 1)
            assert opened.revision() == head()


@pytest.mark.parametrize("revision", [None, "0003"])
def test_leftovers_of_an_upgrade_by_an_earlier_version_are_cleared_away(tmp_path, revision):
    """The tables of 0004, with the revision still at the one before."""
    path = tmp_path / "adr.sqlite"
    url = f"sqlite:///{path}"
    command.upgrade(alembic_config(url), "0004")
    with closing(sqlite3.connect(path)) as other, other:
        other.execute("delete from alembic_version")
        if revision is not None:
            other.execute("insert into alembic_version values (?)", (revision,))
            other.execute(*AN_ARTIFACT)
    assert "the table target_tasks is of a later revision" in "".join(maintenance.unfinished(path))
    with closing(open_database(url)) as opened:
        assert opened.revision() == head()
        assert count(opened, "artifacts") == (0 if revision is None else 1)
    assert maintenance.check(path) == []


@pytest.mark.parametrize("lacking", [["results"], ["results", "requests"]])
def test_databases_of_earlier_forms_of_0004_are_made_whole(tmp_path, lacking):
    path = tmp_path / "adr.sqlite"
    url = f"sqlite:///{path}"
    command.upgrade(alembic_config(url), "0004")
    with closing(sqlite3.connect(path)) as other, other:
        for table in lacking:
            other.execute(f"drop table {table}")
        other.execute("drop index ix_runs_task_method")
    refused = CliRunner().invoke(app, ["db", "check", "--data-dir", str(tmp_path)])
    assert "the table results is missing" in str(refused.exception)
    with closing(open_database(url)) as opened:
        results.keep_results(opened, runs.create_run(opened, SPEC).id, "1", "{}")
    command.check(alembic_config(url))
    assert maintenance.check(path) == maintenance.unfinished(path) == []


@pytest.mark.parametrize("before_the_old_one_went", [True, False])
def test_a_half_rebuilt_table_is_dropped_or_reported(tmp_path, before_the_old_one_went):
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


def test_a_killed_upgrade_leaves_one_copy_however_often_it_is_killed(tmp_path):
    url = f"sqlite:///{tmp_path / 'old.sqlite'}"
    command.upgrade(alembic_config(url), "0003")
    script = f"from db.session import open_database; open_database({url!r})"
    for name in ("migration_0004", "migration_0006", "upgrade:before"):
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


def test_a_released_migration_is_never_edited():
    """A database that it has made already would not get what was added."""
    known = {
        "0001": "5323830174ba0457ca84de6ad0961ee5",
        "0002": "b2d69612c7aa6fe1098907353dcaeb5d",
        "0003": "13ebde8e0765f1d805528df8af13bd4a",
        "0004": "f9455c8c1f54f6ec906ef9a9b2d4f08a",
        "0005": "0adbfbede86b6497ea2993d4a7101791",
        "0006": "36aef7258166d4450d2148caf19697db",
        "0007": "24312f688af840e2971069b723dc4bfd",
        "0008": "f4c3bf84aa7c9777622fe38d67342916",
        "0009": "ecb6a7d60fb0dbe767e0fe7f0f3f08cd",
        "0010": "71df05a4f2c37c72c83da43fc9d14bfa",
        "0011": "99944ec6c95ed58e0d57052700aeadd2",
    }
    files = Path(schema.__file__).parent.glob("migrations/versions/*.py")
    assert {file.name[:4]: sha256(file.read_bytes())[:32] for file in files} == known


def test_a_database_of_a_later_version_is_left_as_it_is(database_url):
    with closing(open_database(database_url)) as database, database.write("test") as session:
        session.execute(text("update alembic_version set version_num = '0999'"))
    with pytest.raises(DatabaseNewer, match="revision 0999, which this version does not know"):
        open_database(database_url)
    with closing(Database(database_url)) as later:
        assert later.revision() == "0999"
    if database_url.startswith("sqlite"):
        (line,) = maintenance.unfinished(Path(database_url.removeprefix("sqlite:///")))
        assert line.startswith("revision 0999 is of a later version of the service")


def test_migrations_go_down_to_nothing_and_up_again(database_url):
    config = alembic_config(database_url)
    open_database(database_url).close()
    command.downgrade(config, "base")
    command.upgrade(config, "head")
    reopened = open_database(database_url)
    with reopened.read() as session:
        assert "runs" in inspect(session.connection()).get_table_names()
    reopened.close()
