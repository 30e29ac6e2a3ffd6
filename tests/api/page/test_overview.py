"""The first page's best methods."""

from collections import defaultdict
from threading import Lock
from types import SimpleNamespace

from adr_service.events import RunStarted
from adr_service.methods.catalogue import methods
from api.page import overview
from db import benchmarks, events
from tests.db.finished import finished_benchmark


def test_the_best_method_is_found_again_where_a_run_has_changed(file_database):
    """A run that was resumed and stopped again has the state that it had before."""
    id = finished_benchmark(file_database)
    service = SimpleNamespace(database=file_database, leaders={}, comparing=defaultdict(Lock))
    finished = [SimpleNamespace(id=id, is_finished=True)]
    best = overview._leaders(service, finished)
    assert not methods()[best[id]["method"]].is_reference
    changed, _ = service.leaders[id]
    service.leaders[id] = changed, {"method": "kept"}
    assert overview._leaders(service, finished) == {id: {"method": "kept"}}
    run = benchmarks.runs_of(file_database, id)[0]
    events.append_event(file_database, run.id, RunStarted(submission=2))
    assert overview._leaders(service, finished) == best
    assert overview._leaders(service, [SimpleNamespace(id=id, is_finished=False)]) == {}


def test_one_benchmark_whose_table_fails_hides_no_other(file_database, monkeypatch):
    id = finished_benchmark(file_database)
    service = SimpleNamespace(database=file_database, leaders={}, comparing=defaultdict(Lock))
    monkeypatch.setattr(overview, "results_json", lambda *given: "no JSON")
    assert overview._leaders(service, [SimpleNamespace(id=id, is_finished=True)]) == {id: None}


def test_the_first_page_waits_for_no_comparison_of_others(file_database):
    id = finished_benchmark(file_database)
    service = SimpleNamespace(database=file_database, leaders={}, comparing=defaultdict(Lock))
    finished = [SimpleNamespace(id=id, is_finished=True)]
    with service.comparing[id]:
        assert overview._leaders(service, finished) == {}
    assert set(overview._leaders(service, finished)) == {id}
