"""Planted cases: repeatable, hidden from the diagnosis, and as strong as asked for."""

import numpy as np
import pytest

from adr_service.blind_test.cases import Hidden
from adr_service.blind_test.outside import OUTSIDE
from adr_service.blind_test.planting import (
    EPISODES,
    STEPS,
    draw_case,
    hide,
    sized_effect,
)
from adr_service.effects.base import Effect
from tests.hidden import arm


def test_a_case_is_the_same_for_the_same_generator_and_starts_off_the_truth():
    task, nominal = arm()
    one, other = (draw_case(task, nominal, np.random.default_rng(5), 0.3) for _ in range(2))
    assert one.effects == other.effects
    np.testing.assert_array_equal(one.measurement.qpos, other.measurement.qpos)
    assert np.all(one.nominal.start != nominal.start)


def test_a_case_without_effects_has_none_and_a_case_outside_has_no_known_one():
    task, nominal = arm()
    nothing = draw_case(task, nominal, np.random.default_rng(5), 0.3, count=0)
    outside = draw_case(task, nominal, np.random.default_rng(5), 0.3, outside=True)
    assert (nothing.effects, nothing.outside) == ((), None)
    assert outside.effects == ()
    assert outside.outside in OUTSIDE


@pytest.mark.parametrize("outside", ["torque_ripple", "position_dependent_friction"])
def test_a_key_that_was_made_before_the_catalogue_had_an_effect_is_read(outside):
    given = {"kind": "outside", "ratio": 0.3, "effects": [], "outside": outside}
    assert Hidden.model_validate({"task": "arm", **given}).outside == outside
    assert outside not in OUTSIDE


def test_a_hidden_robot_has_friction_that_varies():
    """By its load alone: without commands there is none."""
    task, nominal = arm()
    effects = [Effect("joint_load_dependent_friction", "joint:elbow", (0.3,))]
    still, moved = np.zeros((2, 10, 2)), np.ones((2, 10, 2))
    for commands, is_same in ((still, True), (moved, False)):
        free, braked = (
            hide(task, nominal, np.random.default_rng(1), each, commands=commands)
            for each in ([], effects)
        )
        assert np.array_equal(free.qpos, braked.qpos) is is_same


def test_effects_are_sized_by_the_motions_of_their_own_recording():
    """Saturation shows where commands are large, which differs from recording to recording."""
    rarely, often = (
        sized_effect(*arm(), np.random.default_rng(seed), 0.3, ["actuator_saturation"])
        for seed in (0, 4)
    )
    assert rarely.location == often.location
    assert rarely.values[0] > 1.1 * often.values[0]


def test_two_effects_of_a_case_are_at_two_places():
    case = draw_case(*arm(), np.random.default_rng(6), 0.3, count=2)
    assert len({effect.location for effect in case.effects}) == 2


def test_a_bias_of_a_sensor_moves_its_readings_and_no_others():
    task, nominal = arm()
    bias = Effect("sensor_bias", "sensor:elbow.position", (0.1,))
    plain, biased = (hide(task, nominal, np.random.default_rng(7), e) for e in ([], [bias]))
    assert len(plain.time) == EPISODES * (STEPS + 1)
    np.testing.assert_allclose((biased.qpos - plain.qpos)[:, 1], 0.1, atol=1e-12)
    np.testing.assert_array_equal(biased.qpos[:, 0], plain.qpos[:, 0])
    np.testing.assert_array_equal(biased.qvel, plain.qvel)


def test_a_sensor_is_late_by_the_motion_at_its_moment_and_not_by_the_rows_before():
    """Late readings of a position differ from it by its velocity then, which changes fast."""
    task, nominal = arm()
    delay = 1e-4
    late = Effect("sensor_delay", "sensor:elbow.position", (delay,))
    plain, shown = (hide(task, nominal, np.random.default_rng(7), e) for e in ([], [late]))
    inside = np.flatnonzero(np.diff(plain.episode, prepend=-1) == 0)
    velocity = plain.qvel[inside, 1]  # with noise of .01 rad/s, of several rad/s
    before = (plain.qpos[inside, 1] - plain.qpos[inside - 1, 1]) / plain.period()
    found = (plain.qpos - shown.qpos)[inside, 1] / delay
    errors = [np.sqrt(np.mean((found - each) ** 2)) for each in (velocity, before)]
    assert errors[0] < 0.2 * errors[1]


def test_a_larger_ratio_is_a_larger_effect():
    strengths = []
    for ratio in (0.1, 0.3):
        (effect,) = draw_case(*arm(), np.random.default_rng(100), ratio).effects
        strengths.append(abs(effect.values[0]))
    assert strengths[1] / strengths[0] == pytest.approx(3.0, rel=0.15)
