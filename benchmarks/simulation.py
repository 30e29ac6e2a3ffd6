"""Steps per second of our replay, rollout and training environment, against their limit.

The limit is the same `mujoco.batch` calls on the same states with nothing around them. All are
measured side by side in one run, on one thread, medians of five; only the ratios mean something
on another machine. Writes build/bench/simulation_<task>.json.
"""

import itertools
import json
import statistics
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
from mujoco.batch import Batch

from adr_service.distributions import Uniform
from adr_service.simulation.batch import Simulations, compiled
from adr_service.simulation.rollout import run_episodes
from adr_service.simulation.vec_env import RandomizedVecEnv
from adr_service.tasks.base import Task
from adr_service.tasks.catalogue import TASKS, VARIANTS
from adr_service.training.policy import Policy

ROUNDS, STEPS = 5, 60


def main() -> None:
    folder = Path("build/bench")
    folder.mkdir(parents=True, exist_ok=True)
    for task in TASKS.values():
        result = measure(task)
        (folder / f"simulation_{task.name}.json").write_text(json.dumps(result, indent=1))
        print(f"{task.name}: steps per second on one thread, and share of the limit")
        for name, rate in result.items():
            limit = result["limit_12" if name == "vec_env" else "limit_256"]
            print(f"  {name:10s} {rate:10.0f}  {rate / limit:6.1%}")


def measure(task: Task) -> dict[str, float]:
    """Medians over interleaved rounds."""
    subjects: dict[str, Callable[[], float]] = {
        "limit_256": lambda: limit(task, 256),
        "rollout": lambda: rollout(task, 256),
        "limit_12": lambda: limit(task, 12),
        "vec_env": lambda: vec_env(task, 12),
    }
    rates: dict[str, list[float]] = {name: [] for name in subjects}
    for _ in range(ROUNDS):
        for name, subject in subjects.items():
            rates[name].append(subject())
    return {name: statistics.median(values) for name, values in rates.items()}


def limit(task: Task, n: int) -> float:
    """The batch alone, under the actions of the policy's first observation."""
    batch = Batch(compiled(task.xml), n, 1)
    start = task.initial(n, np.random.default_rng(0))
    batch.bind("qpos")[:], batch.bind("qvel")[:] = start
    batch.bind("ctrl")[:] = policy(task).act(task.observe(start))
    return timed(n, lambda: [batch.step(nstep=task.frame_skip) for _ in range(STEPS)])


def rollout(task: Task, n: int) -> float:
    """Closed loop with a network of 2x128."""
    hidden = VARIANTS[task.name]["vanilla"].hidden
    simulations = Simulations(task, hidden.source, n)
    simulations.set_dynamics(np.tile(hidden.values, (n, 1)))
    start = task.initial(n, np.random.default_rng(0))
    act = policy(task).act
    return timed(n, lambda: run_episodes(task, simulations, act, start, STEPS))


def vec_env(task: Task, n: int) -> float:
    hidden = VARIANTS[task.name]["vanilla"].hidden
    truth = Uniform.point(hidden.source.space, hidden.values)
    env = RandomizedVecEnv(task, hidden.source, truth, n, np.random.default_rng(0))
    actions = policy(task).act(env.reset())
    return timed(n, lambda: [env.step(actions) for _ in range(STEPS)])


def policy(task: Task) -> Policy:
    """A small random network: its actions are near zero, so that nothing falls early."""
    rng = np.random.default_rng(0)
    widths = (len(task.columns), 128, 128, len(task.action_low))
    layers = tuple(
        (rng.normal(0, 0.01, (b, a)).astype(np.float32), np.zeros(b, np.float32))
        for a, b in itertools.pairwise(widths)
    )
    return Policy(layers, "tanh", task.action_low, task.action_high)


def timed(n: int, work: Callable[[], object]) -> float:
    started = time.perf_counter()
    work()
    return n * STEPS / (time.perf_counter() - started)


if __name__ == "__main__":
    main()
