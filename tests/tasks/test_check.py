"""The check of tasks names the rule that a broken task breaks."""

from copy import copy
from dataclasses import replace

import numpy as np
import pytest

from adr_service.errors import InvalidInput
from adr_service.tasks.base import Entry, State
from adr_service.tasks.catalogue import BUILT_IN
from adr_service.tasks.check import check_task


@pytest.mark.parametrize(
    ("function", "wrong", "message"),
    [
        ("observe", lambda self, state: state.qpos, r"observe gave shape \(3, 2\) .* \(3, 4\)"),
        ("reward", lambda self, b, a, s: np.zeros((3, 1)), r"reward gave shape \(3, 1\)"),
        ("terminated", lambda self, state: np.zeros(1), "terminated gave shape"),
        ("state", lambda self, o: State(o[:, :2] + 1, o[:, 2:]), "must give the measured columns"),
        ("reward", lambda self, b, a, s: np.full(3, np.nan), "reward must be finite; it gave .nan"),
        ("reward", lambda self, b, a, s: {}["rod"], "KeyError: 'rod'"),
        ("terminated", lambda self, state: np.zeros(3), "must give booleans; it gave float64"),
        (
            "initial",
            lambda self, n, rng: State(np.zeros(2), np.zeros(2)),
            r"initial's qpos gave shape \(2,\) for 3 states; expected is \(3, 2\)",
        ),
        ("xml", "<mujoco><nothing/></mujoco>", "MuJoCo cannot compile the model"),
    ],
)
def test_a_task_that_breaks_a_rule_is_named_with_the_rule(function, wrong, message):
    arm = BUILT_IN["arm"]
    broken = type("Broken", (type(arm.task),), {function: wrong})()
    with pytest.raises(InvalidInput, match=f"task 'arm': .*{message}"):
        check_task(Entry(broken, arm.variants))


@pytest.mark.parametrize("threshold", [-3.75, 0.0, float("nan"), float("inf")])
def test_a_threshold_by_which_returns_cannot_be_divided_is_refused(threshold):
    """Divided by a negative one, the worst policy would be the best."""
    arm = BUILT_IN["arm"]
    with pytest.raises(InvalidInput, match=f"must be positive and finite; given {threshold}"):
        check_task(Entry(replace(arm.task, reward_threshold=threshold), arm.variants))


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        ({"horizon": 0}, "horizon must be a whole number of 1 or more; given 0"),
        ({"horizon": 1.5}, "horizon must be a whole number of 1 or more; given 1.5"),
        ({"learning_rate": 0.0}, "learning_rate must be positive and finite; given 0.0"),
        ({"learning_rate": np.nan}, "learning_rate must be positive and finite; given nan"),
        ({"learning_rate": np.inf}, "learning_rate must be positive and finite; given inf"),
        ({"frame_skip": 0}, "frame_skip must be a whole number of 1 or more; given 0"),
        ({"action_high": np.array([1.0, -1.0])}, "action_low must be below action_high"),
        (
            {"action_high": np.array([1.0, 2.0])},
            "action 1 has the bounds -1 to 2, beyond the ctrlrange of its actuator, -1 to 1",
        ),
    ],
)
def test_numbers_that_no_task_has_are_refused(changed, message):
    arm = BUILT_IN["arm"]
    task = copy(arm.task)
    for name, value in changed.items():
        object.__setattr__(task, name, value)
    with pytest.raises(InvalidInput, match=f"task 'arm': {message}"):
        check_task(Entry(task, arm.variants))


def test_a_target_that_is_not_the_oracles_simulator_is_refused():
    """The oracle is trained on vanilla's source, so that the upper reference would be wrong."""
    arm = BUILT_IN["arm"]
    vanilla = arm.variants["vanilla"]
    heavy = replace(vanilla.hidden.source, fixed={"joint:*.armature": 5.0})
    geared = replace(vanilla, hidden=replace(vanilla.hidden, source=heavy))
    with pytest.raises(InvalidInput, match=r"'geared' has the fixed values .*'vanilla'.* the same"):
        check_task(Entry(arm.task, {**arm.variants, "geared": geared}))


def test_a_task_without_variants_is_refused():
    with pytest.raises(InvalidInput, match="task 'arm': it has no variant"):
        check_task(Entry(BUILT_IN["arm"].task, {}))


def test_bounds_of_actions_may_be_rounded_to_float32():
    arm = BUILT_IN["arm"]
    task = copy(arm.task)
    object.__setattr__(task, "action_high", np.array([1.0, 1 + 1e-7]))
    check_task(Entry(task, arm.variants))


def test_bounds_of_actions_are_free_where_the_model_limits_no_control():
    arm = BUILT_IN["arm"]
    task = copy(arm.task)
    assert 'warmstart="disable"' in task.xml
    free = task.xml.replace('warmstart="disable"', 'warmstart="disable" clampctrl="disable"')
    unclamped = type("Unclamped", (type(task),), {"xml": free})()
    object.__setattr__(unclamped, "action_high", np.array([1.0, 2.0]))
    check_task(Entry(unclamped, arm.variants))


@pytest.mark.parametrize("variance", [-1e-4, float("nan"), float("inf")])
def test_a_noise_variance_that_no_noise_has_is_refused(variance):
    arm = BUILT_IN["arm"]
    noisy = arm.variants["noisy"]
    wrong = replace(noisy, hidden=replace(noisy.hidden, noise_variance=variance))
    with pytest.raises(InvalidInput, match=f"'noisy' must be 0 or more, and finite; .* {variance}"):
        check_task(Entry(arm.task, {**arm.variants, "noisy": wrong}))


def test_a_truth_below_the_feasible_minimum_is_refused():
    arm = BUILT_IN["arm"]
    vanilla = arm.variants["vanilla"]
    parameter = vanilla.hidden.source.space.parameters[0]
    values = vanilla.hidden.values.copy()
    values[0] = parameter.feasible_low / 2
    light = replace(vanilla, hidden=replace(vanilla.hidden, values=values))
    message = f"truth of {parameter.name} in the variant 'light' is {values[0]:g}, below its"
    with pytest.raises(InvalidInput, match=message):
        check_task(Entry(arm.task, {**arm.variants, "light": light}))
