"""Submissions: one for each Idempotency-Key, stored before it starts."""

import pytest
from fastapi import Response

from adr_service.errors import InvalidInput
from adr_service.specs import BenchmarkExtension, BenchmarkSpec, RunSpec
from api.routes.benchmarks import extend
from api.routes.submissions import extend_benchmark, plan_here, start_benchmark, start_run
from api.service import QueueFull
from db import benchmarks, runs
from db.errors import NotPossible
from db.requests import KeyReused
from tests.api.smoke import SMOKE
from tests.api.standins import Service
from tests.db.finished import proceed

SPEC = RunSpec.model_validate(SMOKE)
BENCHMARK = BenchmarkSpec.model_validate(
    {"tasks": ["arm"], "methods": ["simopt"], "seeds": [0, 1], "preset": "smoke"}
)


@pytest.fixture
def service(file_database):
    return Service(file_database)


def test_a_run_is_stored_and_started(service):
    record = start_run(service, SPEC, None)
    assert runs.get_run(service.database, record.id).spec == SPEC
    assert service.orchestrator.started == [record.id]


def test_a_method_without_its_extra_is_refused_before_anything_is_stored(service, monkeypatch):
    monkeypatch.setattr("adr_service.methods.catalogue.find_spec", lambda name: None)
    spec = RunSpec.model_validate({**SMOKE, "method": "npdr"})
    several = BenchmarkSpec.model_validate({**BENCHMARK.model_dump(), "methods": ["bayes_sim"]})
    _assert_refused(service, spec, several, "needs sbi")


def test_a_backend_that_is_not_installed_is_refused_before_anything_is_stored(service, monkeypatch):
    monkeypatch.setattr("adr_service.training.settings.find_spec", lambda name: None)
    spec = RunSpec.model_validate({**SMOKE, "training": {"backend": "sbx"}})
    several = BenchmarkSpec.model_validate(
        {**BENCHMARK.model_dump(), "training": {"backend": "sbx"}}
    )
    _assert_refused(service, spec, several, "needs sbx-rl")


def _assert_refused(service, spec, several, message):
    """Submit a run and a benchmark, and ask for a cost: each is refused, and nothing is stored."""
    for submit in (
        lambda: start_run(service, spec, None),
        lambda: start_benchmark(service, several, None),
        lambda: plan_here(service, [spec]),
    ):
        with pytest.raises(InvalidInput, match=message):
            submit()
    assert list(runs.list_runs(service.database)) == []


def test_an_extension_that_is_sent_again_with_its_key_adds_nothing_else(service):
    """Its answer was lost: without the key it would be refused, as adding nothing."""
    id = start_benchmark(service, BENCHMARK, None).id
    service.orchestrator.started.clear()
    more = BenchmarkExtension(seeds=[2])
    for _ in range(2):
        extend_benchmark(service, id, more, "once")
    added = [run.id for run in benchmarks.runs_of(service.database, id) if run.spec.seed == 2]
    assert set(added) <= set(service.orchestrator.started)
    assert len(benchmarks.runs_of(service.database, id)) == 9
    with pytest.raises(KeyReused, match="another request"):
        extend_benchmark(service, id, BenchmarkExtension(seeds=[3]), "once")
    other = start_benchmark(service, BENCHMARK, None).id
    with pytest.raises(KeyReused, match="another request"):
        extend_benchmark(service, other, more, "once")
    with pytest.raises(InvalidInput, match="has the seeds 2 already"):
        extend_benchmark(service, id, more, None)


@pytest.mark.parametrize("added", [{"methods": ["npdr"]}, {"seeds": [2]}], ids=str)
def test_an_extension_that_runs_a_method_without_its_extra_is_refused(service, monkeypatch, added):
    methods = ["simopt"] if "methods" in added else ["npdr"]
    spec = BenchmarkSpec.model_validate({**BENCHMARK.model_dump(), "methods": methods})
    id = start_benchmark(service, spec, None).id
    before = runs.list_runs(service.database)
    monkeypatch.setattr("adr_service.methods.catalogue.find_spec", lambda name: None)
    with pytest.raises(InvalidInput, match="npdr needs sbi"):
        extend(id, BenchmarkExtension.model_validate(added), service, Response())
    assert runs.list_runs(service.database) == before


def test_an_extension_by_a_method_that_needs_no_extra_starts_its_runs(service, monkeypatch):
    """The benchmark comes from a service that has the extra."""
    spec = BenchmarkSpec.model_validate({**BENCHMARK.model_dump(), "methods": ["npdr"]})
    id = start_benchmark(service, spec, None).id
    service.orchestrator.started.clear()
    monkeypatch.setattr("adr_service.methods.catalogue.find_spec", lambda name: None)
    extend(id, BenchmarkExtension(methods=["udr"]), service, Response())
    started = [runs.get_run(service.database, id).spec for id in service.orchestrator.started]
    assert [(spec.method.name, spec.seed) for spec in started] == [("udr", 0), ("udr", 1)]


def test_without_a_key_every_request_is_another_run(service):
    first, second = (start_run(service, SPEC, None) for _ in range(2))
    assert first.id != second.id


def test_the_same_key_answers_with_the_same_run(service):
    first, again = (start_run(service, SPEC, "key") for _ in range(2))
    assert again.id == first.id
    assert len(list(runs.list_runs(service.database))) == 1


def test_a_key_belongs_to_one_request(service):
    start_run(service, SPEC, "key")
    with pytest.raises(KeyReused):
        start_run(service, SPEC.model_copy(update={"seed": 1}), "key")


def test_a_key_whose_run_or_benchmark_was_deleted_is_refused_and_makes_nothing(service):
    run = start_run(service, SPEC, "run's")
    proceed(service.database, run, most=0)
    runs.delete_run(service.database, run.id)
    with pytest.raises(NotPossible, match=f"created {run.id}, which was deleted; use a new key"):
        start_run(service, SPEC, "run's")
    benchmark = start_benchmark(service, BENCHMARK, "benchmark's")
    for each in benchmarks.runs_of(service.database, benchmark.id):
        proceed(service.database, each, most=0)
    benchmarks.delete_benchmark(service.database, benchmark.id)
    with pytest.raises(NotPossible, match=f"created {benchmark.id}, which was deleted"):
        start_benchmark(service, BENCHMARK, "benchmark's")
    assert runs.list_runs(service.database) == []


def test_a_refused_run_is_neither_stored_nor_started(service):
    service.refusal = QueueFull("the queue is full")
    with pytest.raises(QueueFull, match="the queue is full"):
        start_run(service, SPEC, None)
    assert list(runs.list_runs(service.database)) == []
    assert service.orchestrator.started == []


def test_a_benchmark_starts_all_its_runs_and_once_per_key(service):
    first, again = (start_benchmark(service, BENCHMARK, "key") for _ in range(2))
    assert again.id == first.id
    started = set(service.orchestrator.started)
    assert started == {run.id for run in runs.list_runs(service.database)}
    assert len(started) == len(list(BENCHMARK.runs()))


def test_a_plan_shares_the_trainings_of_equal_runs(service):
    one, two = (plan_here(service, [SPEC] * n) for n in (1, 2))
    other = plan_here(service, [SPEC, SPEC.model_copy(update={"seed": 1})])
    assert one.trainings == two.trainings < other.trainings
    assert one.cores == service.orchestrator.cores
