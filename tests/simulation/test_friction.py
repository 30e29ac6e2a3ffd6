"""Simulations of a robot whose friction depends on what its joints do."""

from dataclasses import replace

import mujoco
import numpy as np
import pytest

from adr_service.effects.base import Effect
from adr_service.errors import InvalidInput
from adr_service.simulation.batch import Simulations, check_effects
from adr_service.tasks.base import State
from adr_service.tasks.catalogue import get_task, source_of

TASK = get_task("arm")
LOAD = Effect("joint_load_dependent_friction", "joint:elbow", (0.3,))
SLIPPERY = Effect("joint_coulomb_friction", "joint:elbow", (0.2,))


def simulations(*effects, n=3):
    source = replace(source_of("arm", "vanilla"), effects=effects)
    found = Simulations(TASK, source, n)
    middle = (source.space.low + source.space.high) / 2
    found.set_dynamics(np.tile(middle, (n, 1)))
    return found


def moved(found, rows=None, steps=30):
    """States (steps, n, 4) from the same start under the same commands."""
    state = TASK.initial(found.n, np.random.default_rng(0))
    found.set_state(state)
    actions = np.random.default_rng(1).uniform(-1, 1, (steps, found.n, 2))
    states = []
    for each in actions:
        found.step(each)
        states.append(np.concatenate(found.state[:2], axis=1))
    return np.array(states)


def test_friction_is_that_of_mujocos_own_steps():
    found = simulations(SLIPPERY, LOAD, n=1)
    states, model = moved(found), found.model(0)
    model.dof_frictionloss[1] = 0.2
    start = TASK.initial(1, np.random.default_rng(0))
    actions = np.random.default_rng(1).uniform(-1, 1, (30, 1, 2))
    data = mujoco.MjData(model)
    data.qpos[:], data.qvel[:] = start.qpos[0], start.qvel[0]
    gear = model.actuator("elbow").gear[0]
    for row, expected in zip(actions[:, 0], states[:, 0], strict=True):
        data.ctrl[:] = row
        model.dof_frictionloss[1] = 0.2 + 0.3 * gear * abs(row[1])
        mujoco.mj_step(model, data, TASK.frame_skip)
        np.testing.assert_allclose(np.concatenate([data.qpos, data.qvel]), expected, rtol=1e-9)


def test_no_strength_changes_no_bit():
    nothing = replace(LOAD, values=(0.0,))
    np.testing.assert_array_equal(
        moved(simulations(SLIPPERY, nothing)), moved(simulations(SLIPPERY))
    )


def test_a_friction_is_forgotten_with_the_state_and_the_dynamics():
    """Earlier steps change neither later ones nor the models."""
    used, new = simulations(LOAD), simulations(LOAD)
    moved(used)
    used.set_dynamics(new.dynamics)
    np.testing.assert_array_equal(used.model(0).dof_frictionloss, 0.0)
    moved(used)
    used.set_state(State(np.zeros((3, 2)), np.zeros((3, 2)), np.empty((3, 0))))
    np.testing.assert_array_equal(used.model(0).dof_frictionloss, 0.0)
    np.testing.assert_array_equal(moved(used), moved(new))


def test_new_dynamics_of_one_simulation_leave_the_others_their_friction():
    one, other = simulations(SLIPPERY, LOAD), simulations(SLIPPERY, LOAD)
    moved(one)
    one.set_dynamics(one.dynamics[:1], np.array([0]))
    np.testing.assert_array_equal(moved(one), moved(other))


def test_drives_among_the_parameters_are_refused_where_their_torque_matters():
    source = replace(
        source_of("arm", "vanilla"), effects=(LOAD,), fixed={"actuator:elbow.gear": 3.0}
    )
    with pytest.raises(InvalidInput, match=r"arm has actuator:elbow\.gear among its parameters"):
        check_effects(TASK, source)
    place = Effect("joint_position_dependent_friction", "joint:elbow", (0.1, 0.05, 0.0, 9.0))
    check_effects(TASK, replace(source, effects=(SLIPPERY, place)))
