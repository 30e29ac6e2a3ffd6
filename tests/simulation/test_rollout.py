"""Closed-loop episodes of the arm: their ends, their noise, and random actions."""

import numpy as np
import pytest

from adr_service.errors import InvalidInput
from adr_service.simulation.batch import Simulations
from adr_service.simulation.rollout import follow, random_actions, run_episodes
from adr_service.tasks.base import State
from adr_service.tasks.catalogue import get_task, hidden_of
from tests.tasks.cases import NAMES, TASKS

ARM = get_task("arm")


def simulations_of(n):
    hidden = hidden_of("arm", "vanilla")
    simulations = Simulations(ARM, hidden.source, n)
    simulations.set_dynamics(np.tile(hidden.values, (n, 1)))
    return simulations


def full_power(observations):
    """Swings the arm over its limit."""
    return np.ones((len(observations), 2))


def no_power(observations):
    return np.zeros((len(observations), 2))


def test_noise_of_sensors_stays_out_of_the_state_that_a_task_shows_as_it_is():
    """`observe` may give the state's own array; its noise earned rewards and ended episodes."""

    class Bare(type(ARM)):
        def observe(self, state):
            return state.qvel

        def reward(self, before, actions, after):
            return np.abs(after.qvel - before.qvel).sum(axis=1)

    initial = State(np.zeros((3, 2)), np.zeros((3, 2)))  # it hangs at rest
    rng = np.random.default_rng(0)
    bare = Bare(columns=("one [rad/s]", "other [rad/s]"), measured=2)
    episodes = run_episodes(
        bare, simulations_of(3), no_power, initial, 20, lambda: rng.normal(size=(3, 2))
    )
    assert np.abs(episodes.rewards).max() < 1e-9
    assert np.abs(episodes.observations).max() > 1


def test_nothing_is_earned_or_recorded_after_the_end():
    initial = ARM.initial(3, np.random.default_rng(0))
    episodes = run_episodes(ARM, simulations_of(3), full_power, initial, 200)
    for row, length in enumerate(episodes.lengths):
        assert 0 < length < 200
        assert np.all(episodes.rewards[row, length:] == 0)
        assert np.isnan(episodes.actions[row, length:]).all()
        assert np.isfinite(episodes.observations[row, : length + 1]).all()
        assert np.isnan(episodes.observations[row, length + 1 :]).all()


def test_a_row_does_not_depend_on_the_rows_beside_it():
    initial = ARM.initial(4, np.random.default_rng(0))

    def act(observations):
        return np.sin(3 * observations[:, :2])

    together = run_episodes(ARM, simulations_of(4), act, initial, 50)
    alone = State(initial.qpos[2:3], initial.qvel[2:3])
    single = run_episodes(ARM, simulations_of(1), act, alone, 50)
    np.testing.assert_array_equal(together.observations[2], single.observations[0])


def test_noise_reaches_the_policy_and_does_not_move_the_arm():
    initial = ARM.initial(2, np.random.default_rng(0))
    clean = run_episodes(ARM, simulations_of(2), no_power, initial, 30)
    noisy = run_episodes(
        ARM, simulations_of(2), no_power, initial, 30, lambda: np.full((2, 4), 0.5)
    )
    np.testing.assert_allclose(noisy.observations, clean.observations + 0.5)
    np.testing.assert_array_equal(noisy.rewards, clean.rewards)


def test_a_diverged_simulation_ends_its_episode_and_earns_nothing_in_its_last_step():
    initial = ARM.initial(2, np.random.default_rng(0))
    initial.qvel[1] = 1e12
    episodes = run_episodes(ARM, simulations_of(2), no_power, initial, 5)
    assert episodes.diverged.tolist() == [False, True]
    assert episodes.lengths.tolist() == [5, 1]
    assert episodes.returns[1] == 0
    assert episodes.returns[0] > 0


def test_a_reward_that_is_not_finite_is_refused_by_the_tasks_name():
    class Undefined(type(ARM)):
        def reward(self, before, actions, after):
            return np.array([0.0, np.nan])

    initial = ARM.initial(2, np.random.default_rng(0))
    with pytest.raises(InvalidInput, match=r"the reward of arm must be finite .* it was nan"):
        run_episodes(Undefined(), simulations_of(2), no_power, initial, 5)


def test_a_reward_after_the_end_of_an_episode_may_be_anything():
    class Undefined(type(ARM)):
        def reward(self, before, actions, after):
            return np.where(self.terminated(before), np.nan, 1.0)

    initial = ARM.initial(3, np.random.default_rng(0))
    episodes = run_episodes(Undefined(), simulations_of(3), full_power, initial, 200)
    assert len(set(episodes.lengths.tolist())) > 1
    np.testing.assert_array_equal(episodes.returns, episodes.lengths)


def test_returns_are_the_sums_of_rewards():
    initial = ARM.initial(3, np.random.default_rng(0))
    episodes = run_episodes(ARM, simulations_of(3), no_power, initial, 20)
    np.testing.assert_allclose(episodes.returns, [sum(row) for row in episodes.rewards])


def test_following_goes_on_after_a_fall():
    initial = ARM.initial(3, np.random.default_rng(0))
    seen = follow(ARM, simulations_of(3), full_power, initial, 200)
    assert seen.shape == (3, 201, 4)
    assert np.isfinite(seen).all()


@pytest.mark.parametrize("task", TASKS, ids=NAMES)
def test_random_actions_are_uniform_within_the_tasks_bounds_and_repeat(task):
    observations = np.zeros((4000, len(task.columns)))
    actions = random_actions(task, np.random.default_rng(1))(observations)
    again = random_actions(task, np.random.default_rng(1))(observations)
    np.testing.assert_array_equal(actions, again)
    assert np.all((actions >= task.action_low) & (actions <= task.action_high))
    width = task.action_high - task.action_low
    np.testing.assert_allclose(actions.var(axis=0), width**2 / 12, rtol=0.1)
