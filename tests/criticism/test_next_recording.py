"""Commands of the recording to make next."""

import numpy as np
import pytest

from adr_service.criticism.measurements import Measurement
from adr_service.criticism.next_recording import next_recording, recorded_limits
from adr_service.criticism.pipeline import criticise
from adr_service.effects.base import Effect
from adr_service.errors import InvalidInput
from adr_service.npz import read_arrays
from benchmarks.planted import hide
from benchmarks.separation import held, tried
from tests.hidden import arm

LIMITS = np.array([[-1.0, 1.0], [-0.5, 0.25]])


@pytest.fixture(scope="module")
def tied():
    """An armature that the model lacks, its first recording, and the criticism, which is a tie."""
    return poorly_recorded(Effect("joint_armature", "joint:shoulder", (0.02,)))


def poorly_recorded(hidden):
    rng = np.random.default_rng(5)
    first = hide(*arm(), rng, [hidden], commands=held(rng))
    criticism = criticise(arm()[1], first, rng, threads=1)
    assert any(criticism.verdict.tied)
    return hidden, first, criticism


def planned(tied, seed=0, **settings):
    rng = np.random.default_rng(seed)
    return next_recording(tied[2], LIMITS, rng, threads=1, **settings)


def test_the_next_recording_separates_what_it_promised_to():
    """A gain of the shoulder is tied with seven effects, of which the plan promises evidence."""
    found = tried(1)
    assert found is not None
    assert found["hidden"] == "actuator_gain actuator:shoulder"
    assert found["is_promised"]
    assert found["is_separated"]


def test_explanations_that_no_motion_separates_are_not_promised_to_be():
    """A wrong zero of the elbow's sensor does what a wrong zero of its joint does."""
    plan = planned(poorly_recorded(Effect("sensor_bias", "sensor:elbow.position", (0.02,))))
    both = {"sensor_bias sensor:elbow.position", "joint_reference_offset joint:elbow"}
    (pair,) = [s for s in plan.separations if {s.named, s.other} == both]
    assert not pair.is_expected


def test_commands_stay_within_their_limits(tied):
    plan = planned(tied, episodes=5, seconds=1.0)
    assert plan.commands.shape == (5, round(1.0 / plan.period), 2)
    low, high = plan.commands.min(axis=(0, 1)), plan.commands.max(axis=(0, 1))
    assert np.all(low >= LIMITS[:, 0])
    assert np.all(high <= LIMITS[:, 1])
    assert np.ptp(plan.commands[..., 0]) > 1


def test_a_plan_is_the_same_for_the_same_seed_and_a_file(tied):
    one, two, other = planned(tied), planned(tied), planned(tied, seed=1)
    np.testing.assert_array_equal(one.commands, two.commands)
    assert not np.array_equal(one.commands, other.commands)
    arrays = read_arrays(one.to_npz(), ["time", "ctrl", "episode"])
    np.testing.assert_array_equal(arrays["ctrl"].reshape(one.commands.shape), one.commands)
    assert len(np.unique(arrays["episode"])) == 12


def test_without_a_tie_motions_are_chosen_that_show_many_effects(clean):
    data = Measurement(**clean)
    criticism = criticise(arm()[1], data, np.random.default_rng(0), threads=1)
    assert not any(criticism.verdict.tied)
    plan = next_recording(criticism, recorded_limits(data), np.random.default_rng(0), threads=1)
    assert plan.separations == ()
    assert np.all(plan.reach[:, 0] < plan.reach[:, 1])


@pytest.mark.parametrize("limits", [np.zeros((1, 2)), np.array([[1.0, -1.0], [-1.0, 1.0]])])
def test_wrong_limits_are_refused(tied, limits):
    with pytest.raises(InvalidInput, match="must be 2 pairs, the lower first"):
        next_recording(tied[2], limits, np.random.default_rng(0))
