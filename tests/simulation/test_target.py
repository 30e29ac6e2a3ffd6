"""The simulated target: recordings and evaluations under the hidden truth."""

import numpy as np
import pytest

from adr_service.errors import InvalidInput
from adr_service.simulation.batch import control_period
from adr_service.simulation.replay import Replay, check_recorded
from adr_service.simulation.rollout import random_actions
from adr_service.simulation.target import simulate_evaluation, simulate_rollout
from adr_service.tasks.catalogue import get_task, hidden_of
from tests.tasks.cases import CASES, IDS

ARM = get_task("arm")


def no_power(observations):
    return np.zeros((len(observations), 2))


@pytest.mark.parametrize(("task", "variant"), CASES, ids=IDS)
def test_a_rollout_is_a_recording_of_its_task_and_repeats_with_the_seed(task, variant):
    one, again = (
        simulate_rollout(
            task,
            variant,
            random_actions(task, np.random.default_rng(1)),
            15,
            np.random.default_rng(0),
        )
        for _ in range(2)
    )
    check_recorded(task, one)
    assert 0 < len(one) <= 15
    assert one.episode_count == 1
    assert one.dt == control_period(task)
    assert one.to_npz() == again.to_npz()


def test_the_truth_replays_a_noise_free_rollout():
    hidden = hidden_of("arm", "vanilla")
    data = simulate_rollout(ARM, "vanilla", no_power, 50, np.random.default_rng(0))
    replay = Replay(ARM, hidden.source, data, 1, 1)
    assert replay.mean_squared_error(hidden.values[None])[0] < 1e-25


def test_the_noisy_variant_measures_the_same_motion_with_noise():
    clean, noisy = (
        simulate_rollout(ARM, variant, no_power, 100, np.random.default_rng(0))
        for variant in ("vanilla", "noisy")
    )
    noise = noisy.observations - clean.observations
    variance = hidden_of("arm", "noisy").noise_variance
    assert noise.var() == pytest.approx(variance, rel=4 * np.sqrt(2 / noise.size))


def test_an_evaluation_runs_full_episodes():
    episodes = simulate_evaluation(ARM, "vanilla", no_power, 3, np.random.default_rng(0))
    assert episodes.lengths.tolist() == [ARM.horizon] * 3
    assert episodes.returns.shape == (3,)


def test_a_target_that_diverges_at_once_has_nothing_to_record():
    task = type("Explosive", (type(ARM),), {"initial": exploding})()
    with pytest.raises(InvalidInput, match="the simulated target arm diverged at its first step"):
        simulate_rollout(task, "vanilla", no_power, 5, np.random.default_rng(0))


def exploding(self, n, rng):
    state = ARM.initial(n, rng)
    state.qvel[:] = 1e12
    return state
