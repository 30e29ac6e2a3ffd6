"""The training environment: fresh dynamics per episode, horizons, seeds, SB3's wrappers."""

import numpy as np
import pytest
from stable_baselines3.common.vec_env import VecMonitor

from adr_service.distributions import Gaussian, Uniform
from adr_service.errors import InvalidInput
from adr_service.simulation.vec_env import RandomizedVecEnv
from adr_service.tasks.catalogue import get_task, hidden_of, source_of

ARM, SOURCE = get_task("arm"), source_of("arm", "vanilla")
TRUTH = Uniform.point(SOURCE.space, hidden_of("arm", "vanilla").values)
PRIOR = Gaussian.prior(SOURCE.space)


def made(distribution=PRIOR, n=4, seed=0):
    return RandomizedVecEnv(ARM, SOURCE, distribution, n, np.random.default_rng(seed))


def test_new_dynamics_are_drawn_at_each_episodes_start_and_only_then():
    env = made()
    env.reset()
    before = env.dynamics
    ended = np.zeros(4, dtype=bool)
    for _ in range(60):
        _, _, done, infos = env.step(np.ones((4, 2)))
        changed = np.any(env.dynamics != before, axis=1)
        np.testing.assert_array_equal(changed, done)
        assert all(
            ("terminal_observation" in info) == d for info, d in zip(infos, done, strict=True)
        )
        before, ended = env.dynamics, ended | done
    assert ended.any()


def test_an_episode_is_cut_at_the_horizon_and_says_so():
    env = made(TRUTH)
    env.reset()
    for _ in range(ARM.horizon):
        _, _, done, infos = env.step(np.zeros((4, 2)))
    assert done.all()
    assert all(info["TimeLimit.truncated"] for info in infos)


def test_the_seed_determines_every_observation():
    rollouts = []
    for _ in range(2):
        env = made(seed=5)
        observations = [env.reset()]
        observations += [env.step(np.ones((4, 2)))[0] for _ in range(80)]
        rollouts.append(np.array(observations))
    np.testing.assert_array_equal(*rollouts)


def test_draws_moved_onto_a_bound_are_counted():
    env = made(n=200)
    env.reset()
    assert env.adjusted > 0


def test_sb3s_own_wrappers_work_on_it():
    env = VecMonitor(made(TRUTH))
    env.reset()
    for _ in range(ARM.horizon):
        *_, infos = env.step(np.zeros((4, 2)))
    assert infos[0]["episode"]["l"] == ARM.horizon


def test_a_diverged_simulation_ends_its_episode_and_is_counted():
    env = made(TRUTH)
    env.reset()
    state = env.simulations.state
    state.qvel[1] = 1e12
    env.simulations.set_state(state)
    observations, rewards, done, infos = env.step(np.zeros((4, 2)))
    assert done.tolist() == [False, True, False, False]
    assert env.diverged == 1
    assert rewards[1] == 0
    assert not infos[1]["terminal_observation"].any()
    assert not infos[1]["TimeLimit.truncated"]
    assert np.isfinite(observations).all()


def test_environments_of_a_batch_have_nothing_to_set_or_to_call():
    env = made(n=3)
    assert env.get_attr("render_mode") == [None] * 3
    assert env.env_is_wrapped(VecMonitor, [0, 2]) == [False, False]
    with pytest.raises(AttributeError, match="no attribute 'gravity' to set"):
        env.set_attr("gravity", 0)
    with pytest.raises(AttributeError, match="no method 'jump'"):
        env.env_method("jump")


@pytest.mark.parametrize("wrong", [np.nan, -np.inf])
def test_a_reward_that_is_not_finite_is_refused_by_the_tasks_name(wrong):
    class Undefined(type(ARM)):
        def reward(self, before, actions, after):
            return np.array([0.0, wrong])

    env = RandomizedVecEnv(Undefined(), SOURCE, TRUTH, 2, np.random.default_rng(0))
    env.reset()
    with pytest.raises(InvalidInput, match=f"the reward of arm must be finite .* it was {wrong}"):
        env.step(np.zeros((2, 2)))
