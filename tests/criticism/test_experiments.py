"""Experiments that separate two explanations."""

from dataclasses import replace

import numpy as np

from adr_service.blind_test.planting import hide
from adr_service.criticism.evidence import fit
from adr_service.criticism.experiments import separating_experiment
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
    assert "actuator:elbow" in found.description
    assert found.is_worth_it
    assert found.separation > found.recorded > 0
    assert (equal.separation, equal.is_worth_it) == (0, False)
