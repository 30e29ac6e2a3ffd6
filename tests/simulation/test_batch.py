"""The batch of simulations: threads, divergence, and inputs that it refuses."""

import dataclasses

import numpy as np
import pytest

from adr_service.errors import InvalidInput
from adr_service.simulation.batch import Batches, Simulations, control_period
from adr_service.tasks.base import State
from adr_service.tasks.catalogue import get_task, source_of, variants_of
from tests.tasks.cases import CASES, IDS, NAMES, TASKS

N = 5


def drawn(task, variant, steps):
    """Dynamics, initial state and actions (steps, N, a) of N simulations."""
    rng = np.random.default_rng(0)
    space = source_of(task.name, variant).space
    dynamics = rng.uniform(space.low, space.high, (N, len(space)))
    actions = rng.uniform(task.action_low, task.action_high, (steps, N, len(task.action_low)))
    return dynamics, task.initial(N, rng), actions


def simulated(task, variant, dynamics, initial, actions, threads=1):
    """States over time, (steps, N, nq + nv + derived)."""
    simulations = Simulations(task, source_of(task.name, variant), N, threads=threads)
    simulations.set_dynamics(dynamics)
    simulations.set_state(initial)
    states = []
    for row in actions:
        simulations.step(row)
        states.append(np.concatenate(simulations.state, axis=1))
    return np.array(states)


@pytest.mark.parametrize(("task", "variant"), CASES, ids=IDS)
def test_the_number_of_threads_changes_nothing(task, variant):
    case = (task, variant, *drawn(task, variant, steps=60))
    np.testing.assert_array_equal(simulated(*case), simulated(*case, threads=3))


@pytest.mark.parametrize("task", TASKS, ids=NAMES)
def test_a_diverged_simulation_stays_nan_and_leaves_the_others_unchanged(task):
    dynamics, initial, actions = drawn(task, "vanilla", steps=20)
    qvel = initial.qvel.copy()
    qvel[2] = np.nan
    with_one_broken = simulated(task, "vanilla", dynamics, State(initial.qpos, qvel), actions)
    whole = simulated(task, "vanilla", dynamics, initial, actions)
    assert np.isnan(with_one_broken[-1, 2]).any()
    others = [0, 1, 3, 4]
    np.testing.assert_array_equal(with_one_broken[:, others], whole[:, others])


@pytest.mark.parametrize("task", TASKS, ids=NAMES)
def test_a_simulation_beyond_mujocos_bound_has_diverged_though_it_is_finite(task):
    """MuJoCo's bound is 1e10."""
    dynamics, initial, _ = drawn(task, "vanilla", steps=1)
    simulations = Simulations(task, source_of(task.name, "vanilla"), N)
    simulations.set_dynamics(dynamics)
    initial.qvel[2, -1] = 1e12
    simulations.set_state(initial)
    assert not simulations.diverged.any()
    simulations.step(np.zeros_like(task.action_low))
    assert simulations.diverged.tolist() == [False, False, True, False, False]
    observations = task.observe(simulations.state)
    assert np.isnan(observations[2, : task.measured]).any()
    assert np.isfinite(np.delete(observations, 2, axis=0)).all()
    simulations.set_state(task.initial(1, np.random.default_rng(0)), np.array([2]))
    simulations.step(np.zeros_like(task.action_low))
    assert not simulations.diverged.any()


def test_a_cheetah_at_a_million_radians_per_second_has_diverged():
    """After a step it is at 1e118 rad/s, which is finite: a test of the bound itself."""
    task = get_task("half_cheetah")
    simulations = Simulations(task, source_of("half_cheetah", "vanilla"), 1)
    simulations.set_dynamics(variants_of("half_cheetah")["vanilla"].truth[None])
    state = task.initial(1, np.random.default_rng(0))
    state.qvel[0, -1] = 1e6
    simulations.set_state(state)
    simulations.step(np.zeros(6))
    assert simulations.diverged[0]


def test_setting_some_rows_leaves_the_others_alone():
    dynamics, initial, actions = drawn(get_task("arm"), "vanilla", steps=3)
    simulations = Simulations(get_task("arm"), source_of("arm", "vanilla"), N)
    simulations.set_dynamics(dynamics)
    simulations.set_state(initial)
    rows = np.array([1, 3])
    simulations.set_dynamics(2 * dynamics[rows], rows)
    simulations.set_state(State(initial.qpos[rows] + 1, initial.qvel[rows]), rows)
    expected = dynamics.copy()
    expected[rows] *= 2
    np.testing.assert_array_equal(simulations.dynamics, expected)
    moved = simulations.state.qpos - initial.qpos
    np.testing.assert_allclose(moved, np.array([[0, 0], [1, 1], [0, 0], [1, 1], [0, 0]]))
    simulations.step(actions[0])
    assert not simulations.diverged.any()


@pytest.mark.parametrize("actions", [np.zeros((5, 1)), np.zeros(1), np.full(3, np.nan)])
def test_actions_of_the_wrong_shape_or_not_finite_are_refused(actions):
    simulations = Simulations(get_task("hopper"), source_of("hopper", "vanilla"), 5)
    with pytest.raises(InvalidInput, match=r"finite, of shape \(5, 3\)"):
        simulations.step(actions)


def test_no_more_dynamics_are_simulated_than_were_asked_for():
    batches = Batches(get_task("arm"), source_of("arm", "vanilla"), 3)
    asked, simulated = np.arange(1.0, 29.0).reshape(7, 4), []

    def simulate(simulations):
        simulated.append(simulations.n)
        return simulations.dynamics.copy()

    for count in (7, 1, 3, 5):
        np.testing.assert_array_equal(batches.run(simulate, asked[:count]), asked[:count])
    assert simulated == [3, 3, 1, 1, 3, 3, 2]


@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_dynamics_that_are_not_finite_are_refused(bad):
    simulations = Simulations(get_task("arm"), source_of("arm", "vanilla"), 1)
    with pytest.raises(InvalidInput, match="finite"):
        simulations.set_dynamics(np.array([[1.0, bad, 1.0, 1.0]]))


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"action_low": [-1.0]}, "bounds 1 and 2 actions; its model has 2 controls"),
        ({"measured": 5}, "measures 5 of 4 columns"),
        ({"measured": 0}, "measures 0 of 4 columns"),
    ],
)
def test_a_task_whose_parts_do_not_fit_is_refused(changes, message):
    task = dataclasses.replace(get_task("arm"), **changes)
    with pytest.raises(InvalidInput, match=message):
        Simulations(task, source_of("arm", "vanilla"), 1)


@pytest.mark.parametrize(
    "state",
    ['dyntype="filter" dynprm="0.1" gaintype="fixed"', 'delay="0.01" nsample="5"'],
)
def test_a_model_whose_steps_depend_on_more_than_the_state_is_refused(state, monkeypatch):
    task = get_task("arm")
    more = f'<general name="more" joint="shoulder" {state}/></actuator>'
    changed = task.xml.replace("</actuator>", more)
    monkeypatch.setattr(type(task), "xml", changed)
    with pytest.raises(InvalidInput, match="has actuators or sensors with a state of their own"):
        Simulations(task, source_of("arm", "vanilla"), 1)


def test_the_control_period_is_the_time_step_times_the_frame_skip():
    assert control_period(get_task("arm")) == pytest.approx(0.02)
    assert control_period(get_task("humanoid")) == pytest.approx(0.015)
