"""One small benchmark of all methods, computed once for the tests of what reports make of it."""

from dataclasses import replace

import pytest

from adr_service.benchmark.comparison import Outcome
from adr_service.events import IterationFinished
from adr_service.programs import run
from adr_service.specs import BenchmarkSpec
from adr_service.stages.local import LocalStages

ITERATIONS = 2  # the paper has 5
METHODS = ["udr", "bayrn", "simopt", "simopt_1", "droid", "dropo", "sysid"]


def with_a_third_seed(outcomes):
    """The first seed's outcomes again as a third's: fewer than three seeds have no interval."""
    return [
        *outcomes,
        *(
            replace(each, spec=each.spec.model_copy(update={"seed": 2}))
            for each in outcomes
            if each.spec.seed == 0
        ),
    ]


@pytest.fixture(scope="session")
def benchmark():
    """(spec, stages, outcomes) of the whole protocol, with references, and of the data study."""
    spec = BenchmarkSpec.model_validate(
        {
            "tasks": ["arm"],
            "variants": ["vanilla", "noisy"],
            "methods": METHODS,
            "collectors": ["simopt", "prior", "random"],
            "seeds": [0, 1],
            "preset": "smoke",
            "iterations": ITERATIONS,
            "training": {"max_steps": 200, "evaluate_every": 200, "learning_starts": 190},
        }
    )
    stages = LocalStages()
    outcomes = [
        Outcome(each, event)
        for each in spec.runs()
        for event in run(each, stages)
        if isinstance(event, IterationFinished)
    ]
    return spec, stages, outcomes
