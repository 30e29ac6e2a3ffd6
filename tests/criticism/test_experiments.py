"""Experiments that separate two explanations."""

from dataclasses import replace

import numpy as np

from adr_service.blind_test.planting import hide
from adr_service.criticism.experiments import separating_experiment
from adr_service.criticism.fits import fit
from adr_service.criticism.measurements import Measurement
from adr_service.criticism.simulator import Simulator
from adr_service.effects.base import Effect
from tests.hidden import arm


def test_the_best_experiment_moves_the_joint_where_two_explanations_differ():
    """Friction at the elbow shows most where the elbow moves; two equal fits never differ."""
    nominal = arm()[1]
    narrow = hide(arm()[0], nominal, np.random.default_rng(402), []).episodes(range(8))
    with Simulator(nominal, narrow, threads=1) as simulator:
        plain = fit(simulator, narrow.sensor_variance())
        pushed = [Effect("joint_coulomb_friction", "joint:elbow", (size,)) for size in (0.0, 0.1)]
        one, other, same = (replace(plain, effects=(c,)) for c in (*pushed, pushed[0]))
        found = separating_experiment(one, other)
        equal = separating_experiment(one, same)
        gentle = replace(narrow, ctrl=narrow.ctrl / 2)
        heard, ignored = (experiment_on(data, one, other) for data in (gentle, unheard(gentle)))
    assert "actuator:elbow" in found.description
    assert found.is_worth_it
    assert found.separation > found.recorded > 0
    assert (equal.separation, equal.is_worth_it) == (0, False)
    assert heard == ignored


def test_the_largest_command_is_one_that_the_robot_obeyed(good):
    data = Measurement(**{**good, "ctrl": good["ctrl"] / 2})
    with (
        Simulator(arm()[1], data, threads=1) as simulator,
        Simulator(arm()[1], unheard(data), threads=1) as ignoring,
    ):
        assert ignoring.largest_command(0) == simulator.largest_command(0)


def experiment_on(data, one, other):
    """The experiment by two fits, within the commands of other data."""
    with Simulator(arm()[1], data, threads=1) as simulator:
        return separating_experiment(*(replace(fit, simulator=simulator) for fit in (one, other)))


def unheard(data):
    """The measurement with full commands in the last rows of its episodes, which nobody obeyed."""
    ctrl = data.ctrl.copy()
    ctrl[[last - 1 for _, last in data.spans()]] = -1.0
    return replace(data, ctrl=ctrl)
