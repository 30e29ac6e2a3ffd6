"""The paper's claims, compared with everything in the database."""

from dataclasses import asdict
from typing import Any

from adr_service.benchmark.claims import METHODS, TASKS, reports
from adr_service.json_values import canonical_json, sha256
from api.results import outcomes_of
from api.service import Service
from db import runs as run_store
from db.runs import RunRecord

_NEEDED = ("oracle", *METHODS)  # the paper's methods, and the oracle that they are judged by


def claim_reports(service: Service) -> list[dict[str, Any]]:
    """One report per budget: each claim, its verdict and the numbers behind it.

    They take long where there are many runs, so they are kept until a run that the claims speak
    of finishes another iteration or is deleted. Requests that come during a computation wait.
    """
    counts = run_store.finished_iterations(service.database, TASKS, _NEEDED)
    version = sha256(canonical_json(counts).encode())
    if (kept := service.claims.get(version)) is not None:
        return kept
    with service.claiming:
        if version not in service.claims:
            outcomes = outcomes_of(service, _papers_runs(service))
            found = [asdict(report) for report in reports(outcomes)]
            service.claims.clear()
            service.claims[version] = found
        return service.claims[version]


def _papers_runs(service: Service) -> list[RunRecord]:
    """The runs that claims speak of, in order of submission."""
    runs = [
        run
        for task in TASKS
        for method in _NEEDED
        for run in run_store.list_runs(service.database, task=task, method=method, limit=None)
    ]
    return sorted(runs, key=lambda run: run.number)
