"""Forces that repeat with the angle of a joint, found among residuals."""

from dataclasses import replace

import numpy as np
import pytest

from adr_service.blind_test.planting import hide
from adr_service.criticism.evidence import fit
from adr_service.criticism.periods import waves_in_turn
from adr_service.criticism.pipeline import criticise
from adr_service.criticism.responses import Responses
from adr_service.criticism.simulator import Simulator
from adr_service.effects.base import Effect
from tests.hidden import arm


def rippling(waves, *others):
    """A recording of the arm, whose elbow ripples so often in a turn."""
    ripple = Effect("joint_torque_ripple", "joint:elbow", (0.05, 0.025, waves))
    return hide(*arm(), np.random.default_rng(5), [ripple, *others])


def waves_of(nominal, data):
    with Simulator(nominal, data, threads=1, finer=3) as simulator:
        start = fit(simulator, data.sensor_variance())
        return waves_in_turn(start, Responses(start).to_forces)


@pytest.mark.parametrize("waves", [7.5, 60.0])
def test_the_waves_of_a_ripple_are_found_to_a_fraction_of_one(waves):
    found = waves_of(arm()[1], rippling(waves).episodes(range(12)))
    assert found["joint:elbow"] == pytest.approx(waves, abs=0.5)


def test_what_repeats_once_in_a_turn_is_left_to_weights():
    """The arm turns often, so that it would be resolved."""
    data = rippling(1.0).episodes(range(12))
    assert np.ptp(data.qpos[:, 1]) > 3 * np.pi
    assert waves_of(arm()[1], data)["joint:elbow"] >= 2


@pytest.mark.parametrize(("reach", "count"), [(1.0, 1), (0.01, 0)])
def test_waves_repeat_within_the_motion_of_the_joint(swinging, reach, count):
    """Twice within it at least, and 400 times in a turn at most."""
    nominal, data = swinging
    found = waves_of(nominal, replace(data, qpos=reach * data.qpos))
    assert len(found) == count
    assert all(2 <= waves * reach / (2 * np.pi) <= 400 / (2 * np.pi) for waves in found.values())


def test_a_ripple_is_named_beside_friction_with_how_often_it_repeats():
    data = rippling(17.3, Effect("joint_coulomb_friction", "joint:elbow", (0.02,)))
    verdict = criticise(arm()[1], data, np.random.default_rng(0), threads=1).verdict
    found = {(cause.kind, cause.location): cause.strengths for cause in verdict.causes}
    kinds = ("joint_torque_ripple", "joint_coulomb_friction")
    assert set(found) == {(kind, "joint:elbow") for kind in kinds}
    sine, cosine, waves = found["joint_torque_ripple", "joint:elbow"]
    assert sine.low < 0.05 < sine.high
    assert cosine.low < 0.025 < cosine.high
    assert waves.low < 17.3 < waves.high
    assert waves.value == pytest.approx(17.3, rel=0.01)
