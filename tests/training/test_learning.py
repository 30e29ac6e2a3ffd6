"""Trainings learn: slow tests, because it takes minutes to see."""

import numpy as np
import pytest

from adr_service.distributions import Uniform
from adr_service.randomness import stream
from adr_service.tasks.catalogue import get_task, hidden_of, source_of
from adr_service.training.train import train
from tests.training.examples import settings

ARM, SOURCE = get_task("arm"), source_of("arm", "vanilla")
OFF_POLICY = {
    "max_steps": 15_000,
    "learning_starts": 1000,
    "gradient_steps": 6,
    "hidden": [64, 64],
    "batch_size": 128,
    "evaluate_every": 1500,
}
CASES = {
    "sac": (0.0005, {**OFF_POLICY, "activation": "relu"}),
    "crossq": (0.001, {**OFF_POLICY, "critic_hidden": [64, 64]}),
    "ppo": (
        0.0005,
        {
            "max_steps": 200_000,
            "environments": 32,
            "rollout_steps": 64,
            "batch_size": 256,
            "epochs": 10,
            "hidden": [64, 64],
            "evaluate_every": 20_000,
        },
    ),
}


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::DeprecationWarning")
@pytest.mark.parametrize("algorithm", CASES)
def test_a_learning_rate_that_is_thirty_times_smaller_learns_less(algorithm):
    """The mean of a learning curve: the worst of four seeds is above the best of the slow ones."""
    pytest.importorskip("sbx")
    rate, others = CASES[algorithm]
    truth = Uniform.point(SOURCE.space, hidden_of("arm", "vanilla").values)

    def areas(rate):
        given = settings(
            algorithm,
            "sbx",
            learning_rate=rate,
            evaluation_episodes=24,
            stop_at_threshold=False,
            **others,
        )
        trained = [train(ARM, SOURCE, truth, given, stream("curve", seed)) for seed in range(4)]
        return [np.mean([point.mean_return for point in training.curve]) for training in trained]

    assert min(areas(rate)) > max(areas(rate / 30))
