"""The paper's claims, compared with all runs."""

from concurrent.futures import ThreadPoolExecutor

import pytest

from api.claims import claim_reports
from db import benchmarks
from tests.api.standins import Service
from tests.db.finished import finished_benchmark

HOPPER = {"tasks": ["hopper"], "methods": ["udr"], "preset": "quick"}


@pytest.fixture
def service(file_database):
    return Service(file_database)


def test_runs_of_the_papers_tasks_and_methods_are_compared(service):
    finished_benchmark(service.database, **HOPPER)
    (report,) = claim_reports(service)
    assert report["preset"] == "quick"
    assert any(finding["evidence"] for finding in report["findings"])


def test_other_tasks_and_methods_are_not_even_read(service):
    finished_benchmark(service.database, tasks=["arm"], methods=["udr"], preset="quick")
    assert claim_reports(service) == []


def test_reports_are_kept_until_the_paper_has_another_iteration_or_one_less(service):
    kept = claim_reports(service)
    finished_benchmark(service.database, tasks=["arm"], methods=["udr"])
    assert claim_reports(service) is kept
    id = finished_benchmark(service.database, **HOPPER)
    found = claim_reports(service)
    assert found != kept
    benchmarks.delete_benchmark(service.database, id)
    assert claim_reports(service) == kept


def test_those_who_ask_at_once_share_one_comparison(service):
    finished_benchmark(service.database, **HOPPER)
    with ThreadPoolExecutor(4) as pool:
        answers = list(pool.map(claim_reports, [service] * 4))
    assert all(answer is answers[0] for answer in answers)
