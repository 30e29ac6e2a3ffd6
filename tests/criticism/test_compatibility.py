"""Measurements and models that do not belong together are refused, with what is expected."""

import numpy as np
import pytest

from adr_service.criticism.compatibility import check_measurement, steps_between
from adr_service.criticism.measurements import Measurement
from adr_service.criticism.nominal import Nominal
from adr_service.criticism.simulator import Simulator
from adr_service.errors import InvalidInput
from adr_service.parameters import ParameterSpace
from tests.hidden import arm


@pytest.mark.parametrize(
    ("name", "change", "message"),
    [
        ("time", lambda a: np.where(np.arange(len(a)) == 7, a - 0.01, a), "from row 6 to 7"),
        ("time", lambda a: 1000 * a, "2000 of the model's steps; accepted are 500 at most"),
        ("time", lambda a: 1.3 * a, "no multiple of the model's step of 0.01"),
        (
            "ctrl",
            lambda a: a[:, :1],
            "ctrl has 1 column; the model needs 2 columns, for shoulder, elbow",
        ),
    ],
)
def test_a_measurement_that_no_simulation_can_follow_is_refused(good, name, change, message):
    measurement = Measurement(**{**good, name: change(good[name])})
    with pytest.raises(InvalidInput, match=message):
        Simulator(arm()[1], measurement)


def test_parts_of_rows_that_are_no_whole_steps_of_the_model_are_refused(good):
    within = np.repeat(good["ctrl"][:, None], 3, axis=1)
    with pytest.raises(
        InvalidInput, match=r"3 parts in a row.*2 steps between rows; accepted are 1, 2"
    ):
        Simulator(arm()[1], Measurement(**good, ctrl_within=within))


@pytest.mark.parametrize(
    ("xml", "message"),
    [
        (
            "<mujoco><nonsense/></mujoco>",
            "the model is no MJCF or URDF that MuJoCo can read; it says",
        ),
        (
            '<mujoco><worldbody><body><joint type="slide"/></body></worldbody></mujoco>',
            "compile",
        ),
        (
            '<mujoco><compiler settotalmass="2"/><worldbody><body><joint type="slide"/>'
            '<geom size="1"/></body></worldbody></mujoco>',
            "settotalmass",
        ),
        (
            '<mujoco><worldbody><body><geom size="1"/></body></worldbody></mujoco>',
            "the model has no joints; needed is at least one slide or hinge",
        ),
        (
            '<mujoco><worldbody><body><freejoint/><geom size="1"/></body></worldbody></mujoco>',
            "free and ball joints",
        ),
        (
            '<mujoco><worldbody><body><joint name="x"/><geom size="1"/></body></worldbody>'
            '<actuator><pid name="p" joint="x" kp="1"/></actuator></mujoco>',
            r"the model's actuators have \[2\] commands",
        ),
        (
            '<mujoco><option><flag sleep="enable"/></option><worldbody><body>'
            '<joint name="x"/><geom size="1"/></body></worldbody></mujoco>',
            "the flag 'sleep' or 'ipc'",
        ),
    ],
)
def test_a_model_that_cannot_be_criticised_is_refused(good, xml, message):
    with pytest.raises(InvalidInput, match=message):
        Simulator(Nominal.of_model(xml, ParameterSpace(())), Measurement(**good))


def one_long(short, long):
    """A measurement of an arm with episodes of two rows, and one of `long` rows."""
    rows = 2 * short + long
    return Measurement(
        time=np.arange(rows) * 0.02,
        qpos=np.random.default_rng(0).standard_normal((rows, 2)),
        qvel=np.random.default_rng(1).standard_normal((rows, 2)),
        ctrl=np.zeros((rows, 2)),
        episode=np.append(np.repeat(np.arange(short), 2), np.full(long, short)),
    )


def test_more_than_memory_holds_is_refused():
    """One long episode among many short ones: all are padded to the longest."""
    with pytest.raises(InvalidInput, match="4001 episodes, the longest of 60000 rows"):
        check_measurement(arm()[1], one_long(4000, 60_000))


def test_the_responses_to_all_effects_must_fit_in_memory():
    """148 strengths to try and 4 numbers of a state: 4 GB at .84 million transitions, padded."""
    check_measurement(arm()[1], one_long(420, 2000))
    with pytest.raises(InvalidInput, match=r"would take 7.6e\+08 numbers .* are 5e\+08"):
        check_measurement(arm()[1], one_long(649, 2000))


def test_steps_between_rows_are_a_whole_number():
    assert steps_between(0.02, 0.01) == 2
    assert steps_between(0.3, 0.1) == 3  # although 0.3 / 0.1 is not 3 in floating point
    with pytest.raises(InvalidInput, match="no multiple"):
        steps_between(0.025, 0.01)
