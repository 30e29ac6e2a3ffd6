"""SimOpt's update beside others, at the same number of simulations of one trained policy.

    python -m benchmarks.updates [--tasks T …] [--variants V …] [--seeds S …]

Each point records 200 transitions of the policy that the preset `fast` trains on the prior, as in
benchmarks/recovery.py, and spends 5000 simulations of it on SimOpt's cost, from the prior N(2, I):

    default     5 updates of 1000 samples, covariance of the weighted samples, trust region 1
    damped      the covariance keeps its shape (`covariance_damping` 2, guided policy search's own)
    narrow      a trust region of .5
    wide        a trust region of 2
    short       25 updates of 200 samples
    cma_es      pycma's CMA-ES with its default population

Every point is kept in build/bench/updates, so that a study that was stopped goes on where it was.
Prints the distance from the truth (root mean square over parameters, in [0, 4]) and the root mean
square of the deviations: medians over seeds, and the distance's range.
"""

import argparse
import json
import os
import statistics
import time
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict, dataclass
from itertools import product
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np

from adr_service.benchmark.truth import estimation_error
from adr_service.distributions import Gaussian, normalised_std
from adr_service.methods.base import Evidence
from adr_service.methods.simopt import ClosedLoop, SimOptSettings
from adr_service.programs.references import prior_training
from adr_service.programs.steps import problem_of
from adr_service.progress import silent
from adr_service.search.cma_es import belief, strategy
from adr_service.specs import RunSpec
from adr_service.training.policy import Policy
from adr_service.transitions import TransitionDataset
from benchmarks.recovery import TASKS, VARIANTS, inferred, keep, key_of, policy_of, recorded
from workers.cluster import worker_environment

FOLDER = Path("build/bench/updates")
SIMULATIONS = 5000
WAYS: dict[str, dict[str, Any]] = {
    "default": {},
    "damped": {"covariance_damping": 2.0},
    "narrow": {"kl_threshold": 0.5},
    "wide": {"kl_threshold": 2.0},
    "short": {"updates": 25, "samples": 200},
    "cma_es": {},
}


@dataclass(frozen=True)
class Point:
    task: str
    variant: str
    way: str
    seed: int

    @property
    def spec(self) -> RunSpec:
        given = {name: getattr(self, name) for name in ("task", "variant", "seed")}
        method = {"name": "simopt", **WAYS[self.way]}
        return RunSpec.model_validate({**given, "method": method, "preset": "fast"})


def options() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--tasks", nargs="+", choices=TASKS, default=TASKS)
    parser.add_argument("--variants", nargs="+", choices=VARIANTS, default=VARIANTS[:2])
    parser.add_argument("--seeds", nargs="+", type=int, default=[0, 1, 2])
    return parser.parse_args()


def main(given: argparse.Namespace) -> None:
    FOLDER.mkdir(parents=True, exist_ok=True)
    os.environ.update(worker_environment(Path("build/bench/jax").absolute()))
    places = list(product(given.tasks, given.variants))
    # seeds outermost, so that a stopped study has whole repetitions
    points = [Point(*place, way, seed) for seed in given.seeds for place in places for way in WAYS]
    acted = {prior_training(point.spec).digest: point.spec for point in points}
    with ProcessPoolExecutor(
        len(os.sched_getaffinity(0)), mp_context=get_context("spawn"), max_tasks_per_child=1
    ) as pool:
        list(pool.map(policy_of, acted.values()))
        rows = list(pool.map(measured, points))
    print("| task | variant | update | distance: median, range | std | CPU s |")
    print("|---|---|---|---|---|---|")
    for place in places:
        for way in WAYS:
            print(line([row for row in rows if named(row) == (*place, way)]))


def measured(point: Point) -> dict[str, Any]:
    """The row of a point, computed unless it was before."""
    spec = point.spec
    path = FOLDER / f"{point.way}-{key_of(spec, prior_training(spec))}.json"
    if not path.exists():
        policy = policy_of(spec)
        data = recorded(spec, policy)
        found = (
            searched(spec, data, policy) if point.way == "cma_es" else updated(spec, data, policy)
        )
        keep(path, json.dumps({**asdict(point), **found}).encode())
    return json.loads(path.read_text())


def updated(spec: RunSpec, data: bytes, policy: bytes) -> dict[str, Any]:
    found = inferred(spec, data, policy)
    return {name: found[name] for name in ("distance", "posterior_std", "cpu_seconds")}


def searched(spec: RunSpec, data: bytes, policy: bytes) -> dict[str, Any]:
    """The row of CMA-ES on SimOpt's cost."""
    problem, rng = problem_of(spec), np.random.default_rng(spec.seed)
    space, started = problem.source.space, time.process_time()
    es = strategy(np.full(len(space), space.WIDTH / 2), std=1.0, width=space.WIDTH, rng=rng)
    evidence = Evidence(Policy.from_bytes(policy), TransitionDataset.from_npz(data))
    settings = SimOptSettings.model_validate({})
    loop = ClosedLoop(problem, evidence, settings, es.popsize)
    while es.countevals < SIMULATIONS and not es.stop():
        candidates = es.ask()
        costs = loop.costs(space.denormalise(np.array(candidates)), silent)
        es.tell(candidates, costs.tolist())
    estimate = Gaussian(space, *belief(es))
    return {
        "distance": estimation_error(spec.task, spec.variant, estimate.mean),
        "posterior_std": float(np.sqrt(np.mean(normalised_std(estimate) ** 2))),
        "cpu_seconds": round(time.process_time() - started, 1),
    }


def named(row: dict[str, Any]) -> tuple[str, str, str]:
    return row["task"], row["variant"], row["way"]


def line(rows: list[dict[str, Any]]) -> str:
    distances = [row["distance"] for row in rows]
    parts = [
        *named(rows[0]),
        f"{statistics.median(distances):.3f}, {min(distances):.3f} to {max(distances):.3f}",
        f"{statistics.median(row['posterior_std'] for row in rows):.2g}",
        f"{statistics.median(row['cpu_seconds'] for row in rows):.0f}",
    ]
    return f"| {' | '.join(parts)} |"


if __name__ == "__main__":
    main(options())
