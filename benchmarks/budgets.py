"""Distance from the truth by what a search costs: do the default budgets converge?

    python -m benchmarks.budgets [--tasks T …] [--seeds N]

Each point infers once, noise-free, from 200 transitions of random actions, with another value of
the setting that limits the search; DROPO with the epsilon 1e-5, sysid with one start, all else by
default. Every point is kept in build/bench/budgets, so that a study that was stopped goes on where
it was. Prints a table, and draws budgets.svg there: distances (root
mean square over parameters, in [0, 4]; median and range over seeds) by simulated control steps.
"""

import argparse
import json
import os
import statistics
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from itertools import groupby
from multiprocessing import get_context
from pathlib import Path
from typing import Any

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from adr_service.specs import RunSpec
from adr_service.tasks.catalogue import source_of
from benchmarks.recovery import TASKS, inferred, keep, key_of, recorded
from workers.cluster import worker_environment

FOLDER = Path("build/bench/budgets")
# the setting that limits each search, and its values
LIMITS: dict[str, tuple[str, list[int]]] = {
    "droid": ("budget", [250, 500, 1000, 2000, 4000, 8000]),
    "dropo": ("budget", [2, 4, 6, 8, 12, 16, 40]),
    "sysid": ("iterations", [2, 4, 8, 16, 50]),
}
FIXED: dict[str, dict[str, Any]] = {"dropo": {"epsilon": 1e-5}, "sysid": {"starts": 1}}


@dataclass(frozen=True)
class Point:
    task: str
    method: str
    limit: int
    seed: int

    @property
    def spec(self) -> RunSpec:
        name, _ = LIMITS[self.method]
        method = {"name": self.method, name: self.limit, **FIXED.get(self.method, {})}
        given = {"task": self.task, "method": method, "seed": self.seed, "preset": "fast"}
        return RunSpec.model_validate(given)


def options() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--tasks", nargs="+", choices=TASKS, default=TASKS)
    parser.add_argument("--seeds", type=int, default=3)
    return parser.parse_args()


def main(given: argparse.Namespace) -> None:
    FOLDER.mkdir(parents=True, exist_ok=True)
    os.environ.update(worker_environment(Path("build/bench/jax").absolute()))
    with ProcessPoolExecutor(len(os.sched_getaffinity(0)), mp_context=get_context("spawn")) as pool:
        rows = list(pool.map(measured, points(given)))
    print("| task | parameters | method | limit | million steps | distance: median, range | std |")
    print("|---|---|---|---|---|---|---|")
    rows.sort(key=lambda row: (TASKS.index(row["task"]), row["method"], row["limit"]))
    for _, group in groupby(rows, key=lambda row: (row["task"], row["method"], row["limit"])):
        print(line(list(group)))
    draw(rows, given.tasks).savefig(FOLDER / "budgets.svg")


def points(given: argparse.Namespace) -> Iterator[Point]:
    """All points, seeds outermost, so that a stopped study has whole repetitions."""
    for seed in range(given.seeds):
        for task in given.tasks:
            for method, (_, limits) in LIMITS.items():
                yield from (Point(task, method, limit, seed) for limit in limits)


def measured(point: Point) -> dict[str, Any]:
    """The row of a point, computed unless it was before."""
    spec = point.spec
    path = FOLDER / f"{key_of(spec, None)}.json"
    if not path.exists():
        found = inferred(spec, recorded(spec, None), None)
        names = ("distance", "prior_distance", "posterior_std", "steps", "cpu_seconds")
        row = {**vars(point), **{name: found[name] for name in names}}
        keep(path, json.dumps(row).encode())
    return json.loads(path.read_text())


def line(rows: list[dict[str, Any]]) -> str:
    distances = [row["distance"] for row in rows]
    parts = [
        rows[0]["task"],
        str(len(source_of(rows[0]["task"], "vanilla").space)),
        rows[0]["method"],
        str(rows[0]["limit"]),
        f"{statistics.median(row['steps'] for row in rows) / 1e6:.3f}",
        f"{statistics.median(distances):.3f}, {min(distances):.3f} to {max(distances):.3f}",
        f"{statistics.median(row['posterior_std'] for row in rows):.2g}",
    ]
    return f"| {' | '.join(parts)} |"


def draw(rows: list[dict[str, Any]], tasks: list[str]) -> Figure:
    figure = Figure(figsize=(3.2 * len(tasks), 3.2), layout="constrained")
    for axis, task in zip(figure.subplots(1, len(tasks), squeeze=False)[0], tasks, strict=True):
        for method in LIMITS:
            chosen = [row for row in rows if (row["task"], row["method"]) == (task, method)]
            curve(axis, method, chosen)
        prior = next(row["prior_distance"] for row in rows if row["task"] == task)
        axis.axhline(prior, color="grey", linestyle=":")
        axis.set(title=task, xlabel="simulated steps", xscale="log")
        axis.set_yscale("symlog", linthresh=1e-3)
        axis.set_ylim(bottom=0)
    figure.axes[0].set_ylabel("distance from truth (dotted: the prior's)")
    figure.axes[0].legend()
    return figure


def curve(axis: Axes, method: str, rows: list[dict[str, Any]]) -> None:
    """Medians over seeds with their ranges, by limit."""
    groups = [list(group) for _, group in groupby(rows, key=lambda row: row["limit"])]
    x = [statistics.median(row["steps"] for row in group) for group in groups]
    each = [sorted(row["distance"] for row in group) for group in groups]
    (drawn,) = axis.plot(x, [statistics.median(values) for values in each], "o-", label=method)
    low, high = [values[0] for values in each], [values[-1] for values in each]
    axis.fill_between(x, low, high, color=drawn.get_color(), alpha=0.2)


if __name__ == "__main__":
    main(options())
