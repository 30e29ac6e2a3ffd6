"""Recovery of Hopper's masses from different data: numbers of docs/decisions.md.

Distances of estimated means from the truth in [0, 4] coordinates, where the prior's is .70.
First, DROPO (the best of four epsilons) and sysid on 500 transitions of DROPO's published clean
recording (`ADR_DATASETS`, docs/datasets.md), with Gaussian noise put on every observation, also
on those that replays start from. Then SimOpt's 25 updates on one rollout of each of three
policies that stand.

    python benchmarks/recovery.py
"""

import os
from dataclasses import replace
from pathlib import Path

import numpy as np

from adr_service.benchmark.truth import estimation_error
from adr_service.methods.base import Evidence, Problem
from adr_service.methods.dropo import Dropo, DropoSettings
from adr_service.methods.simopt import SimOpt, SimOptSettings
from adr_service.methods.sysid import Sysid, SysidSettings
from adr_service.progress import silent
from adr_service.randomness import stream
from adr_service.simulation.target import simulate_rollout
from adr_service.tasks.catalogue import get_task, variants_of
from adr_service.training.policy import Policy
from adr_service.transitions import TransitionDataset

HOPPER, VANILLA = get_task("hopper"), variants_of("hopper")["vanilla"]
PROBLEM = Problem(HOPPER, VANILLA.source)
RECORDING = "dropo_hopper/hopper10000/hoppermass_n10000"


def distance(mean: np.ndarray) -> float:
    return estimation_error("hopper", "vanilla", mean)


def from_noisy_states(recording: TransitionDataset, variance: float) -> None:
    rng = stream("recovery", variance)
    shape, std = recording.observations.shape, variance**0.5
    noisy = replace(
        recording,
        observations=recording.observations + rng.normal(0, std, shape),
        next_observations=recording.next_observations + rng.normal(0, std, shape),
    )
    print(f"noise of variance {variance:g} on 500 transitions:")
    found = []
    for epsilon in (1e-5, 1e-4, 1e-3, 1e-2):
        method = Dropo(DropoSettings(budget=1500, epsilon=epsilon))
        mean = method.fit(PROBLEM, noisy, stream("dropo"), silent).distribution.mean
        found.append(f"{epsilon:g}: {distance(mean):.3f}")
    print(f"  DROPO, by epsilon: {', '.join(found)}")
    fitted = Sysid(SysidSettings(starts=2)).fit(PROBLEM, noisy, stream("sysid"), silent)
    print(f"  sysid: {distance(fitted.distribution.mean):.3f}")


def standing(rng: np.random.Generator) -> Policy:
    """A random PD controller of Hopper's joints."""
    stiffness, damping = rng.uniform(0, 6), rng.uniform(0, 0.6)
    weights = np.zeros((3, 11), np.float32)
    for joint in range(3):
        weights[joint, 2 + joint], weights[joint, 8 + joint] = -stiffness, -damping
        weights[joint, 1] = rng.normal(0, 3)
    layer = (weights, rng.normal(0, 0.3, 3).astype(np.float32))
    return Policy((layer,), "tanh", HOPPER.action_low, HOPPER.action_high)


def from_standing_policies() -> None:
    rng, found = stream("standing"), []
    while len(found) < 3:
        policy = standing(rng)
        data = simulate_rollout(HOPPER, "vanilla", policy.act, 200, stream("rollout"))
        if len(data) < 200:  # it fell
            continue
        method = SimOpt(SimOptSettings(updates=25, samples=200))
        state = method.start(PROBLEM)
        update = method.tell(PROBLEM, state, Evidence(policy, data), stream("simopt"), silent)
        costs = [u["median_cost"] for u in update.diagnostics["updates"]]
        mean = method.ask(PROBLEM, update.state).mean
        found.append(f"{distance(mean):.2f} (cost divided by {costs[0] / costs[-1]:.0f})")
    print(f"SimOpt on rollouts of three policies that stand: {', '.join(found)}")


if __name__ == "__main__":
    folder = Path(os.environ["ADR_DATASETS"]) / RECORDING
    published = TransitionDataset.from_npy(
        folder, dt=0.008, columns=HOPPER.columns, origin=RECORDING
    ).first(500)
    for variance in (1e-5, 1e-4):
        from_noisy_states(published, variance)
    from_standing_policies()
