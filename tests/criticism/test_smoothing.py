"""Smoothed states of recordings with planted noise."""

from dataclasses import replace

import numpy as np
import pytest

from adr_service.criticism.smoothing import check_smoothable, planned_steps, smooth
from adr_service.errors import InvalidInput
from adr_service.tasks.catalogue import get_task, source_of
from tests.planted import ARM, PLANTED, SOURCE, SPACE, distance, recorded, waving_policy
from tests.recordings import recording

NOISE = 0.02
CLEAN = recorded(waving_policy(), episodes=3, steps=60)


def noisy(data, seed=0):
    """The recording with one error for each reading of a state."""
    rng, parts = np.random.default_rng(seed), []
    for part in data.split():
        seen = np.concatenate([part.observations, part.next_observations[-1:]])
        seen = seen + NOISE * rng.standard_normal(seen.shape)
        parts.append(replace(part, observations=seen[:-1], next_observations=seen[1:]))
    return type(data).concatenate(parts)


@pytest.fixture(scope="module")
def smoothing():
    return smooth(ARM, SOURCE, noisy(CLEAN))


def other_arm(xml):
    """The arm with another file."""

    class OtherArm(type(ARM)):
        xml = property(lambda self: xml_given)

    xml_given = xml
    return OtherArm()


def rms(errors):
    return np.sqrt(np.mean(errors**2))


def test_most_of_the_noise_is_taken_out_of_the_states(smoothing):
    before = rms(noisy(CLEAN).observations - CLEAN.observations)
    assert rms(smoothing.data.observations - CLEAN.observations) < 0.4 * before


def test_only_observations_change(smoothing):
    given = noisy(CLEAN).to_arrays()
    found = smoothing.data.to_arrays()
    assert given.pop("observations").shape == found.pop("observations").shape
    for name, values in given.items():
        np.testing.assert_array_equal(found[name], values)


def test_the_noise_and_the_parameters_are_estimated(smoothing):
    np.testing.assert_allclose(smoothing.sensor_std, NOISE, rtol=0.4)
    assert distance(smoothing.parameters) < 0.3 * distance((SPACE.low + SPACE.high) / 2)


def test_states_without_noise_stay():
    smoothing = smooth(ARM, SOURCE, CLEAN)
    assert rms(smoothing.data.observations - CLEAN.observations) < 1e-3 * NOISE


def test_smoothing_ignores_the_files_value_of_an_unknown_parameter(smoothing):
    assert "joint:shoulder.damping" in [p.address for p in SPACE.parameters]
    joint = '<joint name="shoulder" damping="{}"/>'
    assert joint.format(2) in ARM.xml
    xml = ARM.xml.replace(joint.format(2), joint.format(4))
    again = smooth(other_arm(xml), SOURCE, noisy(CLEAN))
    np.testing.assert_array_equal(again.data.observations, smoothing.data.observations)


def test_an_unread_position_has_no_noise():
    task, source = get_task("hopper"), source_of("hopper", "vanilla")
    smoothing = smooth(task, source, recording("hopper", 20))
    assert np.isnan(smoothing.sensor_std[0])
    assert np.isfinite(smoothing.sensor_std[1:]).all()


@pytest.mark.parametrize("steps", [1, 2, 5])
def test_a_very_short_recording_is_smoothed_as_well(steps):
    data = noisy(recorded(waving_policy(), PLANTED, steps=steps))
    assert np.isfinite(smooth(ARM, SOURCE, data).data.observations).all()


def test_the_plan_covers_what_is_simulated(smoothing):
    planned = planned_steps(ARM, len(SPACE), len(CLEAN))
    assert 0.3 * planned < smoothing.simulated_steps < 1.5 * planned


def test_two_readings_of_one_state_are_refused():
    other = CLEAN.next_observations.copy()
    other[7] += 0.1
    with pytest.raises(InvalidInput, match="rows 7 and 8 differ"):
        smooth(ARM, SOURCE, replace(CLEAN, next_observations=other))


def test_a_robot_with_a_free_joint_is_refused():
    with pytest.raises(InvalidInput, match="accepted are slides and hinges"):
        check_smoothable(get_task("humanoid"))
    check_smoothable(ARM)


def test_data_of_another_robot_are_refused():
    with pytest.raises(InvalidInput, match="hopper measures"):
        smooth(get_task("hopper"), source_of("hopper", "vanilla"), CLEAN)
