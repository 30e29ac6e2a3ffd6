"""The pages of one benchmark and of several side by side, without Ray."""

import pytest

from adr_service.specs import BenchmarkSpec
from api.page import benchmarks as page
from api.routes.submissions import start_benchmark
from tests.api.standins import Service

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


@pytest.mark.parametrize("separator", ["&id=", "%20"])
def test_more_ids_than_can_be_compared_are_refused_however_they_are_given(service, separator):
    asked = [f"/compare?id={separator.join(f'run_{i}' for i in range(n))}" for n in (50, 51)]
    at_most, too_many = (service.client(page.router).get(address) for address in asked)
    assert at_most.status_code == 404  # the first of them is not there
    assert too_many.status_code == 422
    assert too_many.json()["detail"] == "51 ids are too many to compare; accepted are 50"
