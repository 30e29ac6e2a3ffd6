"""Control steps per second of our replay, rollout and training environment, and of their peers.

All subjects are measured side by side in one run, medians of five interleaved rounds; only the
ratios mean something on another machine. All may use every core: ours by threads, SB3's by
processes. A limit is the batch's own calls on the very states that the subject visits, with
nothing around them and as many threads.

    python benchmarks/simulation.py [task ...]

Writes build/bench/simulation.json: task -> {limit, replay, rollout, vec_env, limit_12, gym_loop,
sb3_subproc}, in steps per second.
"""

import itertools
import json
import os
import statistics
import sys
import time
from collections.abc import Callable
from pathlib import Path

import gymnasium
import mujoco
import numpy as np
from mujoco.batch import Batch
from stable_baselines3.common.vec_env import SubprocVecEnv

from adr_service.distributions import Uniform
from adr_service.simulation.batch import Simulations, control_period
from adr_service.simulation.replay import Replay
from adr_service.simulation.rollout import run_episodes
from adr_service.simulation.vec_env import RandomizedVecEnv
from adr_service.tasks.base import State, Task
from adr_service.tasks.catalogue import get_task, hidden_of
from adr_service.training.policy import Policy
from adr_service.transitions import TransitionDataset

PEERS = {
    "hopper": "Hopper-v5",
    "half_cheetah": "HalfCheetah-v5",
    "walker2d": "Walker2d-v5",
    "humanoid": "Humanoid-v5",
}
ROUNDS = 5
THREADS = len(os.sched_getaffinity(0))
WIDE, NARROW = 256, 12  # simulations
LONGEST_S = 1.0  # of one measurement at the limit
Subject = Callable[[], int]  # does its work, returns how many control steps that was
TARGETS = (  # subject, at least, of
    ("replay", 0.95, "limit"),
    ("rollout", 0.90, "limit"),
    ("vec_env", 0.80, "limit_12"),
    ("vec_env", 4.00, "sb3_subproc"),
)


def main() -> None:
    results = {}
    for name in sys.argv[1:] or PEERS:
        results[name] = measure(get_task(name))
        print(f"{name}: control steps per second on {THREADS} cores")
        for subject, rate in results[name].items():
            print(f"  {subject:12s} {rate:10.0f}")
        for subject, least, of in TARGETS:
            ratio = results[name][subject] / results[name][of]
            missed = "" if ratio >= least else "  MISSED"
            print(f"  {subject} / {of}: {ratio:.2f}, target {least:.2f}{missed}")
        print(f"  vec_env / limit_12 under weaker actions: {by_strength(get_task(name))}")
    path = Path("build/bench/simulation.json")
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps(results, indent=1))
    print(f"written to {path}")


def measure(task: Task) -> dict[str, float]:
    """Median steps per second of each subject."""
    single, many = peer(task), SubprocVecEnv([lambda: peer(task)] * NARROW)
    subjects = {**closed_and_open_loop(task), **training(task), **peers(single, many)}
    rates = medians(subjects)
    single.close()
    many.close()
    order = ("limit", "replay", "rollout", "vec_env", "limit_12", "gym_loop", "sb3_subproc")
    return {name: rates[name] for name in order}


def medians(subjects: dict[str, Subject]) -> dict[str, float]:
    """Steps per second of each subject, over interleaved rounds after one to warm up."""
    rates: dict[str, list[float]] = {name: [] for name in subjects}
    for turn in range(ROUNDS + 1):
        for name, subject in subjects.items():
            started = time.perf_counter()
            steps = subject()
            if turn > 0:
                rates[name].append(steps / (time.perf_counter() - started))
    return {name: statistics.median(values) for name, values in rates.items()}


def by_strength(task: Task) -> str:
    """The training environment's share of the limit under weaker actions: longer episodes."""
    shares = []
    for strength in (0.3, 0.1):
        rates = medians(training(task, strength))
        shares.append(f"{rates['vec_env'] / rates['limit_12']:.2f} at {strength:g}")
    return ", ".join(shares)


def closed_and_open_loop(task: Task) -> dict[str, Subject]:
    """256 simulations with one start and the true dynamics, so that all visit the same states."""
    hidden, act = hidden_of(task.name, "vanilla"), policy(task).act
    dynamics = np.tile(hidden.values, (WIDE, 1))
    simulations = Simulations(task, hidden.source, WIDE, THREADS)
    simulations.set_dynamics(dynamics)
    first = task.initial(1, np.random.default_rng(0))
    start = State(np.tile(first.qpos, (WIDE, 1)), np.tile(first.qvel, (WIDE, 1)))
    length = affordable(task, simulations, start)
    episode = run_episodes(task, simulations, act, start, length)
    length = int(episode.lengths[0])
    controls = episode.actions.swapaxes(0, 1)[:length]
    states = trace(simulations, start, controls)
    data = TransitionDataset(
        observations=episode.observations[0, :length],
        actions=episode.actions[0, :length],
        next_observations=episode.observations[0, 1 : length + 1],
        episodes=np.zeros(length, dtype=np.int64),
        dt=control_period(task),
        columns=task.columns[: task.measured],
        origin="benchmark",
    )
    replay = Replay(task, hidden.source, data, WIDE, length=1, threads=THREADS)

    def replayed() -> int:
        replay.predict(dynamics)
        return WIDE * length

    def rolled_out() -> int:
        return int(run_episodes(task, simulations, act, start, length).lengths.sum())

    return {
        "limit": limit(task, simulations, states, controls),
        "replay": replayed,
        "rollout": rolled_out,
    }


def training(task: Task, strength: float = 1.0) -> dict[str, Subject]:
    """12 environments, random actions, each episode's dynamics within 20 % of the truth."""
    hidden = hidden_of(task.name, "vanilla")
    belief = Uniform(hidden.source.space, hidden.values / 1.2, hidden.values * 1.2)
    length, rng = 400, np.random.default_rng(0)
    low, high = strength * task.action_low, strength * task.action_high
    actions = rng.uniform(low, high, (length, NARROW, len(low)))
    env = RandomizedVecEnv(task, hidden.source, belief, NARROW, np.random.default_rng(1), THREADS)
    states = []
    env.reset()
    for chosen in actions:
        states.append(env.simulations.state)
        env.step(chosen)

    def stepped() -> int:
        for chosen in actions:
            env.step(chosen)
        return NARROW * length

    return {"vec_env": stepped, "limit_12": limit(task, env.simulations, states, actions)}


def peer(task: Task) -> gymnasium.Env:
    """Gymnasium's environment, without MuJoCo's warning on `settotalmass` in its HalfCheetah."""
    mujoco.set_mju_user_warning(lambda text: None)
    try:
        return gymnasium.make(PEERS[task.name])
    finally:
        mujoco.set_mju_user_warning(None)


def peers(single: gymnasium.Env, many: SubprocVecEnv) -> dict[str, Subject]:
    """Gymnasium's environment: alone in a Python loop, and 12 in processes of SB3."""
    length, rng = 400, np.random.default_rng(0)
    single.reset(seed=0)
    many.reset()
    low, high = single.action_space.low, single.action_space.high
    actions = rng.uniform(low, high, (length, NARROW, len(low))).astype(np.float32)

    def looped() -> int:
        for chosen in actions[:, 0]:
            _, _, terminated, truncated, _ = single.step(chosen)
            if terminated or truncated:
                single.reset()
        return length

    def stepped() -> int:
        for chosen in actions:
            many.step(chosen)
        return NARROW * length

    return {"gym_loop": looped, "sb3_subproc": stepped}


def limit(
    task: Task, simulations: Simulations, states: list[State], controls: np.ndarray
) -> Subject:
    """The batch's steps from recorded states under recorded controls."""
    batch = Batch(simulations.model(0), simulations.n, THREADS)
    qpos, qvel, ctrl = batch.bind("qpos"), batch.bind("qvel"), batch.bind("ctrl")

    def work() -> int:
        for state, control in zip(states, controls, strict=True):
            qpos[:], qvel[:], ctrl[:] = state.qpos, state.qvel, control
            batch.step(nstep=task.frame_skip)
        return simulations.n * len(states)

    return work


def trace(simulations: Simulations, start: State, controls: np.ndarray) -> list[State]:
    """The states that controls (T, n, a) are applied in."""
    simulations.set_state(start)
    states = []
    for control in controls:
        states.append(simulations.state)
        simulations.step(control)
    return states


def affordable(task: Task, simulations: Simulations, start: State) -> int:
    """Control steps of all simulations that take about as long as a measurement may."""
    simulations.set_state(start)
    started = time.perf_counter()
    for _ in range(3):
        simulations.step(np.zeros_like(task.action_low))
    return max(3, int(3 * LONGEST_S / (time.perf_counter() - started)))


def policy(task: Task) -> Policy:
    """A small random network: its actions are near zero, so that nothing falls early."""
    rng = np.random.default_rng(0)
    widths = (len(task.columns), 128, 128, len(task.action_low))
    layers = tuple(
        (rng.normal(0, 0.01, (b, a)).astype(np.float32), np.zeros(b, np.float32))
        for a, b in itertools.pairwise(widths)
    )
    return Policy(layers, "tanh", task.action_low, task.action_high)


if __name__ == "__main__":
    main()
