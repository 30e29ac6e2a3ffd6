"""Policies of a study that learned without target data, by their success over the search box.

    python -m benchmarks.curricula [--variant V] archive.adr …

Scores every policy that the archives' finished runs trained on the prior, on UDR's random boxes or
with a curriculum: EPISODES episodes whose dynamics are drawn from the whole search box, the same
ones for all policies. Prints the shares that earn .75 of the task's reward threshold, which is what
the curricula call a success, and .9, the mean return divided by the threshold, and the steps of a
training, which ends early where the policy earns the threshold; a curriculum's on the whole box.
Of a seed with several policies, the mean counts; intervals are Student's over seeds, 95 %.
"""

import argparse
import os
import tempfile
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from itertools import groupby
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np

from adr_service.arrays import Vector
from adr_service.benchmark.statistics import seed_interval
from adr_service.distributions import Uniform
from adr_service.events import RunState
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
from adr_service.stages.train_policy import TrainedPolicy, TrainPolicy
from adr_service.tasks.catalogue import get_task, source_of
from adr_service.training.policy import Policy
from db.runs import list_runs
from db.session import Database
from db.stages import find_result
from db.staging import staged

SUCCESS, SOLVED = 0.75, 0.9  # of the reward threshold
EPISODES = 500


@dataclass(frozen=True)
class Trained:
    """A policy of a run."""

    task: str
    method: str
    seed: int
    stage: TrainPolicy
    result: TrainedPolicy


def options() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("archives", nargs="+", type=Path, metavar="archive.adr")
    parser.add_argument("--variant", default="vanilla")
    return parser.parse_args()


def main(given: argparse.Namespace) -> None:
    trained = sorted(
        (each for archive in given.archives for each in trained_in(archive, given.variant)),
        key=lambda each: (each.task, each.method, each.seed),
    )
    cores = len(os.sched_getaffinity(0))
    with ProcessPoolExecutor(cores, mp_context=get_context("spawn")) as pool:
        scored = zip(trained, pool.map(box_returns, trained), strict=True)
        print("| task | method | earn .75 | earn .9 | mean return | phases | million steps |")
        print("|---|---|---|---|---|---|---|")
        for names, rows in groupby(scored, key=lambda row: (row[0].task, row[0].method)):
            print(f"| {' | '.join([*names, *cells(list(rows))])} |", flush=True)


def trained_in(archive: Path, variant: str) -> Iterator[Trained]:
    """The policies of an archive's finished runs of one variant."""
    with (
        tempfile.TemporaryDirectory() as folder,
        archive.open("rb") as file,
        staged(file, Path(folder)) as archived,
    ):
        for record in list_runs(archived.database, limit=None):
            spec, is_done = record.spec, record.state is RunState.SUCCEEDED
            if is_done and isinstance(spec, RunSpec) and spec.variant == variant:
                yield from trained_by(archived.database, spec)


def trained_by(database: Database, spec: RunSpec) -> Iterator[Trained]:
    for stage in trainings_of(spec):
        with database.read() as session:
            stored = find_result(session, stage.digest)
        assert stored is not None, "a finished run has the results of its trainings"
        yield Trained(spec.task, spec.column, spec.seed, stage, stage.read(stored))


def trainings_of(spec: RunSpec) -> list[TrainPolicy]:
    """The trainings of a run, unless it learns from the target."""
    if isinstance(spec.method, CurriculumSettings):
        return [curriculum_training(spec)]
    if isinstance(spec.method, UdrSettings):
        return [training(spec, box) for box in boxes_of(spec, spec.method)]
    return [prior_training(spec)] if spec.method.name == "prior" else []


def box_returns(trained: Trained) -> Vector:
    """Returns (EPISODES,) divided by the threshold, of episodes over the whole search box."""
    stage = trained.stage
    task, source = get_task(stage.task), source_of(stage.task, stage.variant)
    space, rng = source.space, stream("curricula", stage.task)  # the same for all policies
    simulations = Simulations(task, source, EPISODES)
    simulations.set_dynamics(Uniform(space, space.low, space.high).sample(EPISODES, rng).values)
    initial, policy = task.initial(EPISODES, rng), Policy.from_bytes(trained.result.policy)
    episodes = run_episodes(task, simulations, policy.act, initial, task.horizon)
    return episodes.returns / task.reward_threshold


def cells(rows: list[tuple[Trained, Vector]]) -> list[str]:
    """The cells of a method, by its policies and their returns."""

    def interval(score: Callable[[Vector], Any]) -> str:
        seeds = groupby(rows, key=lambda row: row[0].seed)
        means = [np.mean([score(returns) for _, returns in each]) for _, each in seeds]
        return f"{seed_interval(np.array(means, np.float64))}, {len(means)} seeds"

    return [
        interval(lambda returns: np.mean(returns >= SUCCESS)),
        interval(lambda returns: np.mean(returns >= SOLVED)),
        interval(np.mean),
        f"{np.mean([len(each.result.phases or []) for each, _ in rows]):.0f}",
        f"{np.mean([each.result.steps for each, _ in rows]) / 1e6:.2f}",
    ]


if __name__ == "__main__":
    main(options())
