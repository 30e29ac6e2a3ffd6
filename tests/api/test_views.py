"""Runs and benchmarks as the API answers them."""

import pytest

from adr_service.specs import BenchmarkSpec, RunSpec
from api.views import benchmark_summaries, benchmark_view, run_view
from db import benchmarks, runs
from tests.api.smoke import SMOKE
from tests.api.standins import Service

BENCHMARK = BenchmarkSpec.model_validate(
    {"tasks": ["arm"], "methods": ["simopt"], "seeds": [0], "preset": "smoke"}
)


@pytest.fixture
def service(file_database):
    return Service(file_database)


def test_a_run_has_its_spec_its_links_and_no_error(service):
    record = runs.create_run(service.database, RunSpec.model_validate(SMOKE))
    view = run_view(service, record)
    assert (view.id, view.state, view.error, view.progress) == (record.id, "queued", None, [])
    assert view.spec == record.spec
    names = {"self", "events", "cost", "results", "policy", "distribution", "trainings"}
    assert set(view.links) == names
    assert all(link.startswith(f"/v1/runs/{record.id}") for link in view.links.values())


def test_a_benchmark_counts_the_states_of_its_runs(service):
    record = benchmarks.create_benchmark(service.database, BENCHMARK)
    view = benchmark_view(service, record, benchmarks.runs_of(service.database, record.id))
    assert view.states == {"queued": len(view.runs)}
    assert not view.is_finished
    assert {run.benchmark_id for run in view.runs} == {record.id}
    assert set(view.links) == {"self", "page", "results", "csv", "figures", "claims", "cost"}


def test_summaries_come_in_the_order_of_their_records(service):
    records = [benchmarks.create_benchmark(service.database, BENCHMARK) for _ in range(3)]
    backwards = records[::-1]
    summaries = benchmark_summaries(service, backwards)
    assert [summary.id for summary in summaries] == [record.id for record in backwards]
