"""The check of tasks names the rule that a broken task breaks."""

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


def test_a_task_without_variants_is_refused():
    with pytest.raises(InvalidInput, match="task 'arm': it has no variant"):
        check_task(Entry(BUILT_IN["arm"].task, {}))
