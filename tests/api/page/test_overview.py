"""The first page's best methods."""

from collections import defaultdict
from threading import Lock
from types import SimpleNamespace

import pytest

from adr_service.events import RunStarted
from adr_service.methods.catalogue import methods
from api.page import overview
from db import benchmarks, events
from db.errors import DatabaseUnavailable
from tests.db.finished import finished_benchmark


def ended(id):
    return SimpleNamespace(id=id, is_finished=True, states={"succeeded": 1})


def test_the_best_method_is_found_again_where_a_run_has_changed(file_database):
    """A run that was resumed and stopped again has the state that it had before."""
    id = finished_benchmark(file_database)
    service = SimpleNamespace(database=file_database, leaders={}, comparing=defaultdict(Lock))
    finished = [ended(id)]
    best = overview._leaders(service, finished)
    assert not methods()[best[id]["method"]].is_reference
    changed, _ = service.leaders[id]
    service.leaders[id] = changed, {"method": "kept"}
    assert overview._leaders(service, finished) == {id: {"method": "kept"}}
    run = benchmarks.runs_of(file_database, id)[0]
    events.append_event(file_database, run.id, RunStarted(submission=2))
    assert overview._leaders(service, finished) == best
    assert (
        overview._leaders(
            service, [SimpleNamespace(id=id, is_finished=False, states={"running": 1})]
        )
        == {}
    )


def test_one_benchmark_whose_table_fails_hides_no_other(file_database, monkeypatch):
    odd, sound = (finished_benchmark(file_database) for _ in range(2))
    service = SimpleNamespace(database=file_database, leaders={}, comparing=defaultdict(Lock))
    results_json = overview.results_json

    def failing(service, id, runs):
        return "no JSON" if id == odd else results_json(service, id, runs)

    monkeypatch.setattr(overview, "results_json", failing)
    both = [ended(id) for id in (odd, sound)]
    best = overview._leaders(service, both)
    assert best[odd] is None
    assert best[sound]["method"] in methods()


def test_a_database_that_cannot_be_read_just_now_leaves_no_mark(file_database, monkeypatch):
    id = finished_benchmark(file_database)
    service = SimpleNamespace(database=file_database, leaders={}, comparing=defaultdict(Lock))

    def unavailable(*given):
        raise DatabaseUnavailable("it is away")

    monkeypatch.setattr(overview, "results_json", unavailable)
    with pytest.raises(DatabaseUnavailable):
        overview._leaders(service, [ended(id)])
    assert not service.leaders


def test_the_first_page_waits_for_no_comparison_of_others(file_database):
    id = finished_benchmark(file_database)
    service = SimpleNamespace(database=file_database, leaders={}, comparing=defaultdict(Lock))
    finished = [ended(id)]
    with service.comparing[id]:
        assert overview._leaders(service, finished) == {}
    assert set(overview._leaders(service, finished)) == {id}


def test_a_benchmark_whose_import_was_interrupted_is_not_being_compared(file_database):
    service = SimpleNamespace(database=file_database, leaders={}, comparing=defaultdict(Lock))
    empty = SimpleNamespace(id="bench_0000000000000000", is_finished=True, states={})
    assert overview._leaders(service, [empty]) == {empty.id: None}
