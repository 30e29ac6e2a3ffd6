"""`adr tune`: a search over learning rates, in this process and on its own cluster."""

import os
from collections.abc import Sequence
from dataclasses import asdict
from typing import Any

from pydantic import ValidationError

from adr_service.errors import InvalidInput
from adr_service.json_values import explain
from adr_service.specs import RunSpec


def search(
    spec: dict[str, Any], rates: Sequence[str], seeds: int, cpus: int | None
) -> list[dict[str, Any]]:
    """The trials for the learning rates as typed, the best first."""
    try:
        given = RunSpec.model_validate(spec)
        numbers = [float(rate) for rate in rates]
    except ValidationError as error:
        raise InvalidInput(explain(error, "spec")) from error
    except ValueError as error:
        raise InvalidInput(f"learning rates must be numbers: {error}") from error
    from workers.cluster import RayOptions
    from workers.tuning import tune

    os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")  # no calls home
    options = RayOptions(cpus=cpus, dashboard=False)
    return [asdict(trial) for trial in tune(given, numbers, range(seeds), options)]
