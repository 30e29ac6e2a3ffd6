"""Tables of results, from a database alone."""

import json
from collections import defaultdict
from threading import Lock
from types import SimpleNamespace

from adr_service.events import RunFailed
from adr_service.stages.train_policy import TrainPolicy
from api.results import outcomes_of, results_json
from db import benchmarks, events
from tests.db.finished import finished_benchmark, proceed


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
    note = json.loads(results_json(service, id, benchmarks.runs_of(file_database, id)))["note"]
    assert note.endswith(f"; rows may mix versions: train_policy {now} and {now + 1}")


def test_outcomes_of_runs_that_failed_say_so(file_database):
    """They are compared anew when a run fails, though no iteration has come."""
    service, id = service_of(file_database), finished_benchmark(file_database)
    records = benchmarks.runs_of(file_database, id)
    before = results_json(service, id, records)
    assert not any(each.has_failed for each in outcomes_of(service, records))
    learned = next(record for record in records if record.spec.method.name == "simopt")
    failed = RunFailed(submission=learned.submission, code="internal", message="why")
    events.append_event(file_database, learned.id, failed)
    records = benchmarks.runs_of(file_database, id)
    marked = {each.spec.method.name for each in outcomes_of(service, records) if each.has_failed}
    assert marked == {"simopt"}
    assert json.loads(results_json(service, id, records)) != json.loads(before)
