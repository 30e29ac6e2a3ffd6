"""System identification recovers planted dynamics of the arm, and Hopper's masses."""

import numpy as np
import pytest

from adr_service.methods.base import Problem
from adr_service.methods.sysid import Sysid, SysidSettings
from adr_service.progress import silent
from adr_service.randomness import stream
from adr_service.tasks.catalogue import get_task, hidden_of
from tests.planted import PROBLEM, distance, recorded, waving_policy
from tests.recordings import recording
from tests.recovery.hopper import distance_from_the_masses


@pytest.mark.parametrize(("noise", "tolerance"), [(0.0, 1e-6), (0.003, 0.04)])
def test_sysid_recovers_planted_dynamics(noise, tolerance):
    """Tolerances: rounding, and three times the worst of seeds 0 to 2, .0124."""
    data = recorded(waving_policy(), noise=noise)
    estimate = Sysid(SysidSettings()).fit(PROBLEM, data, stream("sysid"), silent)
    assert distance(estimate.distribution.mean) < tolerance


def test_sysid_recovers_hoppers_masses_from_clean_transitions():
    """Tolerance: 1e-5, relative."""
    hopper, hidden = get_task("hopper"), hidden_of("hopper", "vanilla")
    data, settings = recording("hopper", 60), SysidSettings(starts=2)
    estimate = Sysid(settings).fit(Problem(hopper, hidden.source), data, stream("h"), silent)
    np.testing.assert_allclose(estimate.distribution.mean, hidden.values, rtol=1e-5)


def test_sysid_recovers_hoppers_masses_from_noisy_transitions(hopper_noisy):
    """Tolerance: three times the distance with 200 transitions, .0060."""
    assert distance_from_the_masses(Sysid(SysidSettings(starts=2)), hopper_noisy.first(200)) < 0.02
