"""/v1/claims: the paper's claims, compared with everything in the database."""

from typing import Any

from fastapi import APIRouter

from api.claims import claim_reports
from api.service import ServiceDependency

router = APIRouter(prefix="/v1/claims", tags=["claims"])


@router.get("")
def claims(service: ServiceDependency) -> list[dict[str, Any]]:
    """One report per budget: each claim, its verdict and the numbers behind it."""
    return claim_reports(service)
