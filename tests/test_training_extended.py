"""What an extension is worth: policies of the extended simulator on a target with an effect."""

import numpy as np
import pytest
from scipy import stats

from adr_service.causes import Cause
from adr_service.computation import LocalStages
from adr_service.runs import run
from adr_service.specs import RunSpec
from tests.hidden import named_effects

pytestmark = pytest.mark.filterwarnings("ignore::DeprecationWarning")


def returned(hidden, extension, seed=1):
    """Returns of 50 target episodes of DROPO's policy."""
    spec = {
        "task": "arm",
        "method": "dropo",
        "collector": "random",
        "preset": "demo",
        "iterations": 1,
        "training": {"max_steps": 25_000},
        "seed": seed,
        "extension": extension,
        "target": {"kind": "simulated", "effects": hidden},
    }
    events = list(run(RunSpec.model_validate(spec), LocalStages()))
    (returns,) = [e for e in events if e.type == "iteration_finished"][-1].returns
    return np.array(returns)


def interval(returns):
    """95 % of the mean over episodes."""
    found = stats.bootstrap((returns,), np.mean, rng=np.random.default_rng(0))
    return found.confidence_interval


def test_a_policy_of_the_extended_simulator_returns_more_on_a_target_that_hides_an_effect():
    """One seed of training; 50 target episodes each. More seeds: docs/criticism.md."""
    hidden = Cause("external_force", "body:fore", (-3.0, 0.0, 0.0))
    extension = named_effects("arm", "vanilla", [hidden], seed=500)
    (named,) = extension
    assert (named["kind"], named["location"]) == (hidden.kind, hidden.location)
    np.testing.assert_allclose(named["values"], hidden.values, atol=0.1)
    effects = [{"kind": hidden.kind, "location": hidden.location, "values": list(hidden.values)}]
    without, extended = (interval(returned(effects, e)) for e in ([], extension))
    assert extended.low > without.high
