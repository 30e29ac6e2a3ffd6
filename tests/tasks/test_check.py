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
        ({"frame_skip": 0}, "frame_skip must be a whole number of 1 or more; given 0"),
        ({"action_high": np.array([1.0, -1.0])}, "action_low must be below action_high"),
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
