"""/v1/claims: the paper's claims, compared with everything in the database."""

from dataclasses import asdict
from typing import Any

from fastapi import APIRouter

from adr_service.benchmark.claims import reports
from api.results import outcomes_of
from api.service import ServiceDependency
from db import runs as run_store

router = APIRouter(prefix="/v1/claims", tags=["claims"])


@router.get("")
def claims(service: ServiceDependency) -> list[dict[str, Any]]:
    """One report per budget: each claim, its verdict and the numbers behind it."""
    outcomes = outcomes_of(service, run_store.list_runs(service.database, limit=None))
    return [asdict(report) for report in reports(outcomes)]
