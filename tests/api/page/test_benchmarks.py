"""The pages of one benchmark and of several side by side, without Ray."""

from dataclasses import asdict

import pytest

from adr_service.benchmark.comparison import table
from adr_service.events import RunFailed, RunStarted, RunStopped
from adr_service.specs import BenchmarkSpec
from adr_service.stages.train_policy import TrainPolicy
from api.page import benchmarks as page
from api.page.benchmarks import experiment_of
from api.routes.submissions import start_benchmark
from db.benchmarks import request_cancel_all, runs_of
from db.events import append_event
from tests.api.standins import Service
from tests.benchmark.test_claims import outcome
from tests.db.finished import finished_benchmark, proceed

VISCOUS = {"kind": "joint_viscous_friction", "location": "joint:foot_joint", "values": [0.5]}
TWO = {"tasks": ["arm"], "methods": ["udr"], "seeds": [0, 1], "references": False}
NEEDS_SBI = {"tasks": ["arm"], "methods": ["npdr"], "seeds": [0], "preset": "smoke"}


@pytest.fixture
def service(file_database):
    return Service(file_database)


def test_the_work_left_is_priced_where_a_methods_extra_is_not_installed(service, monkeypatch):
    """As of a benchmark that was imported."""
    id = start_benchmark(service, BenchmarkSpec.model_validate(NEEDS_SBI), None).id
    monkeypatch.setattr("adr_service.methods.catalogue.find_spec", lambda name: None)
    answer = service.client(page.router).get(f"/benchmarks/{id}/left")
    assert answer.status_code == 200
    assert "left on 2 cores" in answer.text


def test_ten_failures_are_shown_and_the_others_counted(service):
    """A method with a defect fails every run of a benchmark."""
    many = {"tasks": ["arm"], "methods": ["udr"], "seeds": list(range(12)), "preset": "smoke"}
    spec = BenchmarkSpec.model_validate({**many, "references": False})
    id = start_benchmark(service, spec, None).id
    failed = RunFailed(submission=1, code="internal", message="a defect")
    for run in runs_of(service.database, id):
        append_event(service.database, run.id, failed)
    shown = service.client(page.router).get(f"/benchmarks/{id}").text
    assert shown.count("</strong> a defect</p>") == 10
    assert '2 more failed: the page of <a href="#runs">each run</a> says why.' in shown


def test_a_benchmark_that_mixes_versions_says_so_on_its_page_and_where_it_is_compared(
    service, monkeypatch
):
    """Its last run was under way when the service was upgraded."""
    id = finished_benchmark(service.database, most=1)
    now = TrainPolicy.version
    monkeypatch.setattr(TrainPolicy, "version", now + 1)
    *_, last = runs_of(service.database, id)
    proceed(service.database, last)
    told = f"ows may mix versions: train_policy {now} and {now + 1}.</p>"
    client = service.client(page.router)
    assert f'<p class="warning">R{told}' in client.get(f"/benchmarks/{id}").text
    assert f'<p class="warning">{id}: r{told}' in client.get(f"/compare?id={id}").text


def test_a_comparison_shows_what_there_is_and_names_the_ids_that_are_not(service):
    """Ids are given with commas, as seeds are, and one benchmark may have expired."""
    id = finished_benchmark(service.database)
    shown = service.client(page.router).get(f"/compare?id={id}, bench_gone,run_0").text
    for kind, gone in (("benchmark", "bench_gone"), ("run", "run_0")):
        assert f"there is no {kind} &#39;{gone}&#39;.</p>" in shown
    assert f'<a href="/benchmarks/{id}">' in shown
    assert f'value="{id} bench_gone run_0"' in shown


def test_a_benchmark_is_resumed_once_what_was_cancelled_has_stopped(service):
    """Else the runs that still stop would be left out."""
    id = start_benchmark(service, BenchmarkSpec.model_validate(TWO), None).id
    one, other = runs_of(service.database, id)
    append_event(service.database, one.id, RunStarted(submission=1))
    request_cancel_all(service.database, id)
    append_event(service.database, other.id, RunStopped(submission=1))  # it had not begun
    client = service.client(page.router)
    shown = client.get(f"/benchmarks/{id}").text
    assert shown.count("running</span>, to be cancelled") == 1
    assert "It can be resumed once all cancelled runs have stopped." in shown
    assert f"/benchmarks/{id}/resume" not in shown
    append_event(service.database, one.id, RunStopped(submission=1))
    shown = client.get(f"/benchmarks/{id}").text
    assert "to be cancelled" not in shown
    assert f"/benchmarks/{id}/resume" in shown


@pytest.mark.parametrize("separator", ["&id=", "%20"])
def test_more_ids_than_can_be_compared_are_refused_however_they_are_given(service, separator):
    asked = [f"/compare?id={separator.join(f'run_{i}' for i in range(n))}" for n in (50, 51)]
    at_most, too_many = (service.client(page.router).get(address) for address in asked)
    assert at_most.status_code == 200
    assert too_many.status_code == 422
    assert too_many.json()["detail"] == "51 ids are too many to compare; accepted are 50"


@pytest.mark.parametrize(
    ("given", "experiment"),
    [
        ({}, "demo"),
        ({"settings": {"samples": 60}}, "demo, simopt.samples = 60"),
        ({"training": {"max_steps": 7000}}, "demo, training.max_steps = 7000"),
        (
            {"target": {"kind": "simulated", "effects": [VISCOUS]}},
            "demo, on a target with effects of its own",
        ),
    ],
)
def test_a_comparison_shows_settings_that_differ_from_the_preset(given, experiment):
    asked = [outcome(1.0, **given), outcome(1.0, method="prior", iteration=0)]
    (row,) = [r for r in (asdict(r) for r in table(asked)) if r["method"] == "simopt"]
    assert experiment_of(row, asked) == experiment
