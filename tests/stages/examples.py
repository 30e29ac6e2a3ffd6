"""Small stages, each with a number that sets it apart from others of its kind."""

import itertools

import numpy as np

from adr_service.effects.base import Effect, domain_of
from adr_service.programs.references import truth_of
from adr_service.specs import RunSpec
from adr_service.stages.criticise import Criticise
from adr_service.stages.evaluate import Evaluate
from adr_service.stages.target_episode import TargetEpisode
from adr_service.stages.target_rollout import TargetRollout
from adr_service.stages.train_policy import TrainPolicy
from adr_service.training.policy import Policy

UNSTABLE = {
    "task": "half_cheetah",  # which ends no episode itself
    "variant": domain_of("vanilla", [Effect("joint_spring", "joint:bthigh", (-1e4,))]),
}


def policy(widths=(4, 8, 8, 2), activation="relu"):
    """An actor with random weights; of the arm, by default."""
    rng = np.random.default_rng(0)
    layers = tuple(
        (rng.normal(size=(b, a)).astype(np.float32), rng.normal(size=b).astype(np.float32))
        for a, b in itertools.pairwise(widths)
    )
    return Policy(layers, activation, np.array([-1.0, -2.0]), np.array([1.0, 4.0]))


def training(seed=0, **changes):
    """A training on the truth of the arm; with settings other than the preset's."""
    given = {"task": "arm", "method": "prior", "preset": "smoke", "training": changes}
    return TrainPolicy(
        task="arm",
        variant="vanilla",
        seed=seed,
        distribution=truth_of("arm", "vanilla"),
        training=RunSpec.model_validate(given).training,
    )


def evaluation(seed=0, policy=b"weights", task="arm"):
    """One episode of a policy."""
    return Evaluate(task=task, variant="vanilla", episodes=1, seed=seed, policy=policy)


def rollout(number=0):
    """A trajectory on the simulated target."""
    return TargetRollout(
        task="arm",
        variant="vanilla",
        transitions=10,
        iteration=number,
        seed=0,
        policy=b"weights",
    )


def episode(run_id="run_a", number=0):
    """A robot's episode."""
    return TargetEpisode(
        task="arm",
        run=run_id,
        purpose="rollout",
        number=number,
        transitions=10,
        seed=0,
        policy=b"weights",
    )


def criticism(seed=0):
    """A stage of the role `inference`."""
    return Criticise(task="arm", variant="vanilla", seed=seed, data=b"measured")


class Speed:
    """A core of a known speed."""

    def __init__(self, rate=1000.0):
        self.rate = rate

    def steps_per_second(self, task):
        return self.rate
