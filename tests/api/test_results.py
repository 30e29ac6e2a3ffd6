"""Tables of results, from a database alone."""

import json
from collections import defaultdict
from dataclasses import replace
from threading import Lock
from types import SimpleNamespace

from sqlalchemy import select

from adr_service.events import RunFailed
from adr_service.plugins import TASKS
from adr_service.stages.train_policy import TrainPolicy
from api.results import _lost, outcomes_of, results_json
from db import benchmarks, events, runs
from db.models import ResultsRow
from tests.db.finished import finished_benchmark, proceed
from tests.db.rows import RESULT, SPEC, commit
from tests.packages import add_entry_point
from tests.stages.examples import evaluation


def kept_version(database):
    with database.read() as session:
        return session.scalars(select(ResultsRow.version)).one()


def service_of(database):
    return SimpleNamespace(database=database, comparing=defaultdict(Lock))


def test_the_note_says_which_versions_a_benchmark_mixes(file_database, monkeypatch):
    """Its last run was under way when the service was upgraded."""
    service, id = service_of(file_database), finished_benchmark(file_database, most=1)
    shown = results_json(service, id, benchmarks.runs_of(file_database, id))
    assert "versions" not in json.loads(shown)["note"]
    now = TrainPolicy.version
    monkeypatch.setattr(TrainPolicy, "version", now + 1)
    *_, last = benchmarks.runs_of(file_database, id)
    proceed(file_database, last)
    found = json.loads(results_json(service, id, benchmarks.runs_of(file_database, id)))
    mixed = f"rows may mix versions: train_policy {now} and {now + 1}"
    assert found["cautions"] == [mixed]
    assert found["note"].endswith(f"; {mixed}")


def test_outcomes_of_another_version_of_their_tasks_package_have_lost_their_distributions(
    file_database, tmp_path, monkeypatch
):
    add_entry_point(tmp_path, TASKS, "math:pi", "upgraded_since")
    monkeypatch.syspath_prepend(tmp_path)
    run_id = runs.create_run(file_database, SPEC).id
    stage = replace(evaluation(task="upgraded_since"), package="broken 0.9")
    commit(file_database, stage, RESULT, run_id)
    specs = {run_id: SimpleNamespace(task="upgraded_since")}
    found = _lost(service_of(file_database), specs)
    assert found[run_id].startswith("computed with broken 0.9, and broken 1.0 is installed")


def test_outcomes_of_runs_that_failed_say_so(file_database):
    """They are compared anew when a run fails, though no iteration has come."""
    service, id = service_of(file_database), finished_benchmark(file_database)
    records = benchmarks.runs_of(file_database, id)
    results_json(service, id, records)
    before = kept_version(file_database)
    assert not any(each.has_failed for each in outcomes_of(service, records))
    learned = next(record for record in records if record.spec.method.name == "simopt")
    failed = RunFailed(submission=learned.submission, code="internal", message="why")
    events.append_event(file_database, learned.id, failed)
    records = benchmarks.runs_of(file_database, id)
    marked = {each.spec.method.name for each in outcomes_of(service, records) if each.has_failed}
    assert marked == {"simopt"}
    results_json(service, id, records)
    assert kept_version(file_database) != before
