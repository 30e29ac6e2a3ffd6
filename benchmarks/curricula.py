"""Policies trained without target data, by their success over the whole search box.

    python -m benchmarks.curricula [--task T] [--methods M …] [--seeds S …] [--processes N]

Each policy is trained with the preset `fast`, then scored by 1000 episodes whose dynamics are
drawn from the whole search box: the shares that earn .75 of the reward threshold, which is what the
curricula call a success, and .9, and the mean return divided by the threshold. UDR has POLICIES
random boxes per seed, whose mean counts. A training ends early where the policy earns the
threshold, a curriculum's on the whole box.

Every policy is kept in build/bench/curricula, so that a study that was stopped goes on where it
was. Prints means over seeds with Student's 95 % interval.
"""

import argparse
import json
import os
import time
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np

from adr_service.arrays import Vector
from adr_service.benchmark.statistics import seed_interval
from adr_service.distributions import Uniform
from adr_service.methods.base import CurriculumSettings
from adr_service.methods.udr import UdrSettings
from adr_service.programs.curriculum import curriculum_training
from adr_service.programs.references import prior_training
from adr_service.programs.steps import training
from adr_service.programs.udr import boxes_of
from adr_service.randomness import stream
from adr_service.simulation.batch import Simulations
from adr_service.simulation.rollout import run_episodes
from adr_service.specs import RunSpec
from adr_service.stages.base import compute
from adr_service.stages.train_policy import TrainPolicy
from adr_service.tasks.catalogue import get_task, source_of
from adr_service.training.policy import Policy
from benchmarks.recovery import TASKS, keep
from workers.cluster import worker_environment

FOLDER = Path("build/bench/curricula")
METHODS = ("prior", "udr", "fixed_dr", "auto_dr", "doraemon", "epopt")
POLICIES = 2  # of UDR, per seed
SUCCESS, SOLVED = 0.75, 0.9  # of the reward threshold
EPISODES = 1000


@dataclass(frozen=True)
class Point:
    method: str
    seed: int
    stage: TrainPolicy


def options() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--task", choices=TASKS, default="hopper")
    parser.add_argument("--methods", nargs="+", choices=METHODS, default=METHODS)
    parser.add_argument("--seeds", nargs="+", type=int, default=[0, 1, 2])
    parser.add_argument("--processes", type=int, default=len(os.sched_getaffinity(0)))
    return parser.parse_args()


def main(given: argparse.Namespace) -> None:
    FOLDER.mkdir(parents=True, exist_ok=True)
    os.environ.update(worker_environment(Path("build/bench/jax").absolute()))
    # seeds outermost, so that a stopped study has whole repetitions
    points = [
        point
        for seed in given.seeds
        for method in given.methods
        for point in points_of(given.task, method, seed)
    ]
    with ProcessPoolExecutor(
        given.processes, mp_context=get_context("spawn"), max_tasks_per_child=1
    ) as pool:
        rows = list(pool.map(measured, points))
    print("| method | earn .75 | earn .9 | mean return | phases | CPU s |")
    print("|---|---|---|---|---|---|")
    for method in given.methods:
        print(line(method, [row for row in rows if row["method"] == method]))


def points_of(task: str, method: str, seed: int) -> list[Point]:
    given = {"task": task, "method": method, "seed": seed, "preset": "fast"}
    spec = RunSpec.model_validate(given)
    return [Point(method, seed, stage) for stage in trainings_of(spec)]


def trainings_of(spec: RunSpec) -> list[TrainPolicy]:
    if isinstance(spec.method, CurriculumSettings):
        return [curriculum_training(spec)]
    if isinstance(spec.method, UdrSettings):
        boxes = boxes_of(spec, spec.method.model_copy(update={"policies": POLICIES}))
        return [training(spec, box) for box in boxes]
    return [prior_training(spec)]


def measured(point: Point) -> dict[str, Any]:
    """The row of a point, computed unless it was before."""
    path = FOLDER / f"{point.method}-{point.seed}-{point.stage.digest[:16]}.json"
    if not path.exists():
        started = time.process_time()
        trained = point.stage.read(compute(point.stage))
        seconds = time.process_time() - started
        returns = box_returns(point.stage, Policy.from_bytes(trained.policy))
        row = {
            "method": point.method,
            "seed": point.seed,
            "returns": np.round(returns, 4).tolist(),
            "steps": trained.steps,
            "phases": [phase.model_dump() for phase in trained.phases or []],
            "curve": [each.model_dump() for each in trained.curve],
            "cpu_seconds": round(seconds, 1),
        }
        keep(path, json.dumps(row).encode())
    return json.loads(path.read_text())


def box_returns(stage: TrainPolicy, policy: Policy) -> Vector:
    """Returns divided by the threshold, of episodes over the whole search box."""
    task, source = get_task(stage.task), source_of(stage.task, stage.variant)
    space, rng = source.space, stream("curricula", stage.task)  # the same for all policies
    simulations = Simulations(task, source, EPISODES)
    simulations.set_dynamics(Uniform(space, space.low, space.high).sample(EPISODES, rng).values)
    initial = task.initial(EPISODES, rng)
    episodes = run_episodes(task, simulations, policy.act, initial, task.horizon)
    return episodes.returns / task.reward_threshold


def line(method: str, rows: list[dict[str, Any]]) -> str:
    parts = [
        method,
        interval_of(rows, lambda returns: np.mean(returns >= SUCCESS)),
        interval_of(rows, lambda returns: np.mean(returns >= SOLVED)),
        interval_of(rows, np.mean),
        f"{np.mean([len(row['phases']) for row in rows]):.0f}",
        f"{np.mean([row['cpu_seconds'] for row in rows]):.0f}",
    ]
    return f"| {' | '.join(parts)} |"


def interval_of(rows: list[dict[str, Any]], score: Callable[[Vector], Any]) -> str:
    seeds = sorted({row["seed"] for row in rows})
    means = [
        np.mean([score(np.array(row["returns"])) for row in rows if row["seed"] == seed])
        for seed in seeds
    ]
    return f"{seed_interval(np.array(means, np.float64))}, {len(seeds)} seeds"


if __name__ == "__main__":
    main(options())
