"""Coverage of 95 % intervals over few seeds, and their errors between equal methods.

    python -m benchmarks.coverage [archive.adr …]

Repeats experiments in worlds whose truth is known. In each, a method's seeds earn what a policy
earns on average: by a normal distribution; by one with two gaits, where a policy learns the
worse one with probability 0.3; and for each archive, by the spread that its methods have: their
seeds' deviations from their method's mean, resampled and smoothed as Silverman's bootstrap does.
Pooled about their means, these show tails and not gaits: three seeds of two gaits look symmetric.
Every seed has one policy with 50 episodes, with a standard deviation of 0.1.

    coverage        share of experiments whose interval contains the truth
    false           share in which two equal methods, compared seed by seed, have an interval of
                    their difference that excludes zero
"""

import sys
import tempfile
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from pathlib import Path

import numpy as np

from adr_service.arrays import Vector
from adr_service.benchmark.comparison import Outcome, returns_of
from adr_service.benchmark.statistics import Interval, bootstrap_interval, seed_interval
from adr_service.events import IterationFinished, RunState
from adr_service.specs import RunSpec
from db.events import events_of
from db.runs import list_runs
from db.staging import staged

World = Callable[[np.random.Generator, int], Vector]  # mean returns of n seeds
SEEDS = (2, 3, 5, 10)  # two have no interval in results, and here is why
EXPERIMENTS = 2000
EPISODES, EPISODE_STD = 50, 0.1


def main(archives: Sequence[str]) -> None:
    worlds: dict[str, tuple[World, float]] = {
        "normal": (lambda rng, n: rng.normal(1.0, 0.15, n), 1.0),
        "two gaits": (two_gaits, 0.7 * 1.0 + 0.3 * 0.6),
    }
    for archive in archives:
        deviations = np.array(list(deviations_of(Path(archive))))
        if len(deviations) < 2 or not deviations.any():
            sys.exit(f"{archive} has no two seeds of a method that differ")
        worlds[Path(archive).stem] = (partial(resampled, deviations), 1.0)
    print("| spread of seeds | seeds | t: coverage | bootstrap: coverage | t: false | ")
    print("|---|---|---|---|---|")
    for name, (world, truth) in worlds.items():
        for count in SEEDS:
            rng = np.random.default_rng(0)
            shares = np.mean([experiment(world, truth, count, rng) for _ in range(EXPERIMENTS)], 0)
            print(f"| {name} | {count} | {' | '.join(f'{100 * s:.0f} %' for s in shares)} |")


def experiment(
    world: World, truth: float, count: int, rng: np.random.Generator
) -> tuple[bool, bool, bool]:
    """Covered by Student's interval; by the bootstrap; two equals told apart."""
    one, other = (measured(world, count, rng) for _ in range(2))
    means, others = one.mean(axis=1), other.mean(axis=1)
    student = seed_interval(means, fewest=2)
    bootstrap = bootstrap_interval([row[None] for row in one], mean, rng, fewest=2)
    return (
        contains(student, truth),
        contains(bootstrap, truth),
        not contains(seed_interval(means - others, fewest=2), 0.0),
    )


def measured(world: World, count: int, rng: np.random.Generator) -> np.ndarray:
    """Returns (seeds, episodes) of an experiment."""
    return world(rng, count)[:, None] + rng.normal(0, EPISODE_STD, (count, EPISODES))


def mean(scores: np.ndarray) -> np.ndarray:
    return scores.mean(axis=-1)


def contains(interval: Interval, value: float) -> bool:
    assert interval.low is not None, "two seeds at least have an interval"
    assert interval.high is not None, "two seeds at least have an interval"
    return interval.low <= value <= interval.high


def two_gaits(rng: np.random.Generator, count: int) -> Vector:
    """Policies that earn 1, or 0.6 with probability 0.3, and a little more or less."""
    return np.where(rng.random(count) < 0.3, 0.6, 1.0) + rng.normal(0, 0.03, count)


def resampled(deviations: Vector, rng: np.random.Generator, count: int) -> Vector:
    """Silverman's smoothed bootstrap of deviations, about 1, with their variance kept."""
    std = deviations.std()
    width = 0.9 * std * len(deviations) ** -0.2
    drawn = rng.choice(deviations, count) + rng.normal(0, width, count)
    return 1.0 + drawn / np.sqrt(1 + (width / std) ** 2)


def deviations_of(archive: Path) -> Iterator[float]:
    """Deviations of an archive's seeds from their method's mean, each method at its last iteration.

    Enlarged as an unbiased variance is. Runs that have not succeeded are at other iterations.
    """
    cells: dict[tuple[str, ...], dict[int, Outcome]] = {}
    with (
        tempfile.TemporaryDirectory() as folder,
        archive.open("rb") as file,
        staged(file, Path(folder)) as archived,
    ):
        for record in list_runs(archived.database, state=RunState.SUCCEEDED, limit=None):
            events = [each.event for each in events_of(archived.database, record.id)]
            finished = [e for e in events if isinstance(e, IterationFinished) and e.returns]
            if finished and isinstance(spec := record.spec, RunSpec):
                key = (spec.task, spec.variant, spec.column)
                cells.setdefault(key, {})[spec.seed] = Outcome(spec, finished[-1])
    for outcomes in cells.values():
        earned = np.array([r.mean() for r in returns_of(list(outcomes.values()))])
        if len(earned) > 1:
            yield from (earned - earned.mean()) * np.sqrt(len(earned) / (len(earned) - 1))


if __name__ == "__main__":
    main(sys.argv[1:])
