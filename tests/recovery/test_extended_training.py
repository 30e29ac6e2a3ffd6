"""Policies trained on an extended simulator return more on a target with that effect."""

import numpy as np
import pytest
from scipy.stats import ttest_ind

from adr_service.effects.base import Effect
from adr_service.programs import run
from adr_service.specs import RunSpec
from adr_service.stages.local import LocalStages
from tests.hidden import named_effects

SEEDS = (1, 2)
pytestmark = pytest.mark.filterwarnings("ignore::DeprecationWarning")


def returned(hidden, extension, seed):
    """Returns (1, 50) of the target episodes of DROPO's policy."""
    spec = {
        "task": "arm",
        "method": "dropo",
        "collector": "random",
        "preset": "demo",
        "iterations": 1,
        "seed": seed,
        "extension": extension,
        "target": {"kind": "simulated", "effects": hidden},
    }
    events = list(run(RunSpec.model_validate(spec), LocalStages()))
    return np.array([e for e in events if e.type == "iteration_finished"][-1].returns)


@pytest.mark.slow  # a minute
def test_policies_of_the_extended_simulator_return_more_on_a_target_that_hides_an_effect():
    """A spring that has to be held against, which no parameter can say."""
    hidden = Effect("joint_spring", "joint:shoulder", (12.0,))
    extension = named_effects("arm", "vanilla", [hidden], seed=500)
    (named,) = extension
    assert (named["kind"], named["location"]) == (hidden.kind, hidden.location)
    np.testing.assert_allclose(named["values"], hidden.values, rtol=0.01)
    effects = [{"kind": hidden.kind, "location": hidden.location, "values": list(hidden.values)}]
    without, extended = (
        [returned(effects, chosen, seed) for seed in SEEDS] for chosen in ([], extension)
    )
    for returns, others in zip(extended, without, strict=True):
        assert ttest_ind(returns.ravel(), others.ravel(), alternative="greater").pvalue < 0.01
