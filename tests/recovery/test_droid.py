"""DROID recovers planted dynamics of the arm, and the masses of the published Hopper."""

import pytest

from adr_service.methods.droid import Droid, DroidSettings
from adr_service.progress import silent
from adr_service.randomness import stream
from tests.planted import PROBLEM, distance, recorded, waving_policy
from tests.recovery.hopper import distance_from_the_masses


@pytest.mark.parametrize(("noise", "tolerance"), [(0.0, 0.003), (0.003, 0.03)])
def test_droid_recovers_planted_dynamics(noise, tolerance):
    """Tolerances: three times the worst of seeds 0 to 2, .001 (rounded up) and .008."""
    data = recorded(waving_policy(), noise=noise)
    estimate = Droid(DroidSettings(budget=600)).fit(PROBLEM, data, stream("droid"), silent)
    assert distance(estimate.distribution.mean) < tolerance


@pytest.mark.parametrize(
    "recording", [pytest.param("hopper_clean", marks=pytest.mark.slow), "hopper_noisy"]
)
@pytest.mark.parametrize("episode", [0, pytest.param(1, marks=pytest.mark.slow)])
def test_droid_recovers_hoppers_masses_from_a_hundred_transitions(request, recording, episode):
    """Tolerance: three times the worst of four episodes, .0018.

    Open loop diverges with 200 transitions; the worst was .06.
    """
    data = request.getfixturevalue(recording).split()[episode].first(100)
    assert distance_from_the_masses(Droid(DroidSettings(budget=600)), data) < 0.006
