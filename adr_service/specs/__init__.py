"""Specs: the request body, the database row and a program's only argument.

    spec = RunSpec.model_validate({"task": "arm", "method": "simopt", "preset": "smoke"})

A run's spec is complete: validation fills from the preset what was not given, so that a stored one
means the same when presets change. Given fields win over the preset, one by one.
"""

from adr_service.specs.benchmark import (
    MAX_RUNS,
    BenchmarkExtension,
    BenchmarkPart,
    BenchmarkSpec,
    members_of,
)
from adr_service.specs.lost import LostBenchmark, LostRun
from adr_service.specs.run import AnyRun, CriticismSpec, RunSpec
from adr_service.specs.target import (
    EXTERNAL_EPISODES,
    AnyTarget,
    ExternalTarget,
    RecordedTarget,
    SimulatedTarget,
)

__all__ = [
    "EXTERNAL_EPISODES",
    "MAX_RUNS",
    "AnyRun",
    "AnyTarget",
    "BenchmarkExtension",
    "BenchmarkPart",
    "BenchmarkSpec",
    "CriticismSpec",
    "ExternalTarget",
    "LostBenchmark",
    "LostRun",
    "RecordedTarget",
    "RunSpec",
    "SimulatedTarget",
    "members_of",
]
