"""Expected coverage of the posteriors that BayesSim and NPDR learn.

    python -m benchmarks.calibration [--task T] [--methods M …] [--truths N] [--noise V]
                                     [--processes P]

Truths are drawn from the prior, which is uniform over the search box. From each, 200 transitions of
random actions are recorded, and the method infers anew, with its default settings. Of every
parameter, the smallest central interval of the posterior's draws that contains the truth is noted.
Where posteriors are calibrated, intervals of level a contain a share a of the truths (Hermans et
al., arXiv 2110.06581): with fewer, the posterior is too sure.

`--noise`: variance of the noise on every measured column, which neither method simulates. Every
inference is kept in build/bench/calibration, so that a study that was stopped goes on where it was.
Prints shares with 95 % intervals, by a bootstrap over truths, and draws calibration.svg there.
"""

import argparse
import json
import os
from collections.abc import Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from adr_service.arrays import Matrix, Vector
from adr_service.distributions import Uniform
from adr_service.json_values import sha256
from adr_service.methods.base import OfflineSettings, Problem
from adr_service.methods.catalogue import methods
from adr_service.progress import silent
from adr_service.randomness import stream
from adr_service.simulation.rollout import random_actions
from adr_service.simulation.target import simulate_recording
from adr_service.stages.infer import Infer
from adr_service.tasks.base import Hidden, Source
from adr_service.tasks.catalogue import get_task, source_of
from adr_service.transitions import TransitionDataset
from benchmarks.recovery import TASKS, TRANSITIONS, keep
from workers.cluster import worker_environment

FOLDER = Path("build/bench/calibration")
METHODS = ("bayes_sim", "npdr")
LEVELS = (0.5, 0.8, 0.95)  # of the table
DRAWS, RESAMPLES = 4000, 2000


@dataclass(frozen=True)
class Point:
    task: str
    method: str
    noise: float  # variance
    number: int  # of the truth


def options() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--task", choices=("arm", *TASKS), default="arm")
    parser.add_argument("--methods", nargs="+", choices=METHODS, default=METHODS)
    parser.add_argument("--truths", type=int, default=40)
    parser.add_argument("--noise", type=float, default=0.0)
    parser.add_argument("--processes", type=int, default=len(os.sched_getaffinity(0)))
    return parser.parse_args()


def main(given: argparse.Namespace) -> None:
    FOLDER.mkdir(parents=True, exist_ok=True)
    os.environ.update(worker_environment(Path("build/bench/jax").absolute()))
    # truths outermost, so that a stopped study has whole repetitions
    points = [
        Point(given.task, method, given.noise, number)
        for number in range(given.truths)
        for method in given.methods
    ]
    with ProcessPoolExecutor(given.processes, mp_context=get_context("spawn")) as pool:
        rows = list(pool.map(measured, points))
    levels = {
        method: np.array([row["levels"] for row in rows if row["method"] == method])
        for method in given.methods
    }
    print(f"| method | {' | '.join(f'{level:.0%}' for level in LEVELS)} | truths |")
    print(f"|---|{'---|' * len(LEVELS)}---|")
    for method, least in levels.items():
        found = coverage(least, LEVELS)
        cells = (f"{share:.2f} [{low:.2f}, {high:.2f}]" for share, low, high in found)
        print(f"| {method} | {' | '.join(cells)} | {len(least)} |")
    draw(levels).savefig(FOLDER / "calibration.svg")


def measured(point: Point) -> dict[str, Any]:
    """The row of a point, computed unless it was before."""
    settings = methods()[point.method].model_validate({})
    assert isinstance(settings, OfflineSettings)
    key = sha256(json.dumps([vars(point), settings.model_dump(), Infer.version]).encode())
    path = FOLDER / f"{key[:16]}.json"
    if not path.exists():
        truth, data = recorded(point)
        problem = Problem(get_task(point.task), source_of(point.task, "vanilla"))
        rng = stream("calibration", *map(str, vars(point).values()))
        found = settings.create().fit(problem, data, rng, silent)
        draws = found.distribution.sample(DRAWS, rng).values
        row = {**vars(point), "levels": least_levels(draws, truth).tolist()}
        keep(path, json.dumps(row).encode())
    return json.loads(path.read_text())


def recorded(point: Point) -> tuple[Vector, TransitionDataset]:
    """A truth (d,) drawn from the search box, and transitions of random actions under it; both
    methods have the same."""
    task, source = get_task(point.task), source_of(point.task, "vanilla")
    rng, space = stream("calibration", point.task, str(point.noise), point.number), source.space
    truth = Uniform(space, space.low, space.high).sample(1, rng).values[0]
    hidden, act = Hidden(Source(space), truth, point.noise), random_actions(task, rng)
    parts: list[TransitionDataset] = []
    while (missing := TRANSITIONS - sum(map(len, parts))) > 0:
        parts.append(simulate_recording(task, hidden, act, missing, rng, "calibration"))
    return truth, TransitionDataset.concatenate(parts)


def least_levels(draws: Matrix, truth: Vector) -> Vector:
    """(d,) levels of the smallest central intervals of draws (n, d) that contain the truth (d,)."""
    below = np.mean(draws < truth, axis=0)
    return np.abs(2 * below - 1)


def coverage(least: Matrix, levels: Sequence[float]) -> Matrix:
    """(levels, 3) shares of truths and parameters (n, d) within intervals of these levels, with
    their 95 % intervals: the parameters of a truth are not independent, so truths are resampled."""
    shares = np.mean(least[..., None] <= np.array(levels), axis=1)  # (n, levels)
    chosen = stream("coverage").integers(len(shares), size=(RESAMPLES, len(shares)))
    low, high = np.quantile(shares[chosen].mean(axis=1), [0.025, 0.975], axis=0)
    return np.column_stack([shares.mean(axis=0), low, high])


def draw(levels: Mapping[str, Matrix]) -> Figure:
    figure = Figure(figsize=(4, 4), layout="constrained")
    axes, grid = figure.subplots(), np.linspace(0, 1, 101).tolist()
    axes.plot([0, 1], [0, 1], color="grey", linestyle=":")
    for method, least in levels.items():
        known, (share, low, high) = methods()[method], coverage(least, grid).T
        axes.plot(grid, share, color=known.colour, label=known.label)
        axes.fill_between(grid, low, high, color=known.colour, alpha=0.2)
    axes.set(xlabel="level of a central interval", ylabel="share of truths within it")
    axes.legend()
    return figure


if __name__ == "__main__":
    main(options())
