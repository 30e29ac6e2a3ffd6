"""DROPO on its authors' Hopper data: the emulated search against the exact one, side by side.

    python benchmarks/dropo.py [budget of both searches, 500] [budget of the full search, 5000]

One trajectory of 500 noise-free transitions, 40 draws, epsilon 1e-5, one thread. Needs
ADR_DATASETS (docs/datasets.md). Writes build/bench/dropo.json:

    means, truth             kg, of the emulated search with the full budget
    full_seconds
    fast_seconds, exact_seconds, speedup            of both searches with the same smaller budget
    exact_objective_at_fast, exact_objective_at_exact   mean exact loss over fresh draws, lower is
                                                        better, of what those two searches found
    exact_se                 standard error of their difference
"""

import json
import os
import sys
import time
from pathlib import Path

import numpy as np
from scipy.stats import qmc

from adr_service.methods.base import Estimate, Problem
from adr_service.methods.dropo import Dropo, DropoSettings, log_likelihood
from adr_service.progress import silent
from adr_service.simulation.replay import Replay
from adr_service.tasks.catalogue import get_task, hidden_of, source_of
from adr_service.transitions import TransitionDataset

EPSILON, DRAWS, FRESH = 1e-5, 40, 8


def main() -> None:
    budget, full = (int(given) for given in (*sys.argv[1:], "500", "5000")[:2])
    task = get_task("hopper")
    problem, data = Problem(task, source_of("hopper", "vanilla")), recorded()
    best, full_seconds = timed(problem, data, full, exact=False)
    fast, fast_seconds = timed(problem, data, budget, exact=False)
    print(f"emulated: {full_seconds:.1f} s for {full}, {fast_seconds:.1f} s for {budget}")
    exact, exact_seconds = timed(problem, data, budget, exact=True)
    losses = np.array([objective(problem, data, e) for e in (fast, exact)])
    difference = losses[0] - losses[1]
    truth = hidden_of("hopper", "vanilla").values
    result = {
        "means": best.distribution.mean.tolist(),
        "truth": truth.tolist(),
        "full_budget": full,
        "full_seconds": full_seconds,
        "budget": budget,
        "fast_seconds": fast_seconds,
        "exact_seconds": exact_seconds,
        "speedup": exact_seconds / fast_seconds,
        "exact_objective_at_fast": float(losses[0].mean()),
        "exact_objective_at_exact": float(losses[1].mean()),
        "exact_se": float(difference.std(ddof=1) / np.sqrt(FRESH)),
    }
    path = Path("build/bench/dropo.json")
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps(result, indent=1))
    print(json.dumps(result, indent=1))
    print("means over truth:", np.round(best.distribution.mean / truth, 5))


def recorded() -> TransitionDataset:
    """The first trajectory of `hopper10000` (gabrieletiboni/dropo)."""
    prefix = Path(os.environ["ADR_DATASETS"]) / "dropo_hopper/hopper10000/hoppermass_n10000"
    columns = get_task("hopper").columns
    return TransitionDataset.from_npy(prefix, dt=0.008, columns=columns, origin="dropo").first(500)


def timed(
    problem: Problem, data: TransitionDataset, budget: int, *, exact: bool
) -> tuple[Estimate, float]:
    settings = DropoSettings(
        budget=budget,
        epsilon=EPSILON,
        exact=exact,
        samples_per_parameter=DRAWS // len(problem.source.space),
    )
    started = time.perf_counter()
    estimate = Dropo(settings).fit(problem, data, np.random.default_rng(0), silent)
    return estimate, time.perf_counter() - started


def objective(problem: Problem, data: TransitionDataset, estimate: Estimate) -> np.ndarray:
    """The exact loss on fresh draws, (FRESH,), the same for every estimate."""
    replay, d = Replay(problem.task, problem.source, data, DRAWS, 1), len(problem.source.space)
    losses = []
    for seed in range(FRESH):
        levels = qmc.LatinHypercube(d, rng=np.random.default_rng(1000 + seed)).random(DRAWS)
        predictions = replay.predict(estimate.distribution.quantile(levels))
        losses.append(-log_likelihood(predictions, replay.targets, EPSILON))
    return np.array(losses)


if __name__ == "__main__":
    main()
