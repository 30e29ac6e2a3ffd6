"""DROPO on its authors' Hopper data: the trust-region search against CMA-ES, side by side.

    python -m benchmarks.dropo [budget of CMA-ES, 500]

One trajectory of 500 noise-free transitions, 40 draws, epsilon 1e-5, one thread. Needs
ADR_DATASETS (docs/datasets.md). Writes build/bench/dropo.json, for both searches:

    seconds, evaluations     of the likelihood; CMA-ES ends with its budget
    means_over_truth         of the masses
    loss, loss_se            mean loss over fresh sets of draws, lower is better, and its standard
                             error
    stopped_by               of the trust region
    speedup                  of the trust region
"""

import json
import sys
import time
from pathlib import Path
from typing import Any, Literal

import numpy as np
from scipy.stats import qmc

from adr_service.methods.base import Estimate, Problem
from adr_service.methods.dropo import Dropo, DropoSettings, log_likelihood
from adr_service.progress import silent
from adr_service.simulation.replay import Replay
from adr_service.tasks.catalogue import get_task, hidden_of, source_of
from adr_service.transitions import TransitionDataset
from benchmarks import sources

Search = Literal["trust_region", "cma_es"]
EPSILON, DRAWS, FRESH = 1e-5, 40, 8


def main() -> None:
    budget = int((*sys.argv[1:], "500")[0])
    task, data = get_task("hopper"), recorded()
    problem = Problem(task, source_of("hopper", "vanilla"))
    result: dict[str, Any] = {
        search: measured(problem, data, search, budget) for search in ("trust_region", "cma_es")
    }
    result["speedup"] = result["cma_es"]["seconds"] / result["trust_region"]["seconds"]
    path = Path("build/bench/dropo.json")
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps(result, indent=1))
    print(json.dumps(result, indent=1))


def recorded() -> TransitionDataset:
    """The first trajectory of `hopper10000` (gabrieletiboni/dropo)."""
    prefix = sources.folder() / "dropo_hopper/hopper10000/hoppermass_n10000"
    columns = get_task("hopper").columns
    return TransitionDataset.from_npy(prefix, dt=0.008, columns=columns, origin="dropo").first(500)


def measured(
    problem: Problem, data: TransitionDataset, search: Search, budget: int
) -> dict[str, Any]:
    """Cost and quality of one search."""
    settings = DropoSettings(
        search=search,
        budget=budget,
        epsilon=EPSILON,
        samples_per_parameter=DRAWS // len(problem.source.space),
    )
    started = time.perf_counter()
    estimate = Dropo(settings).fit(problem, data, np.random.default_rng(0), silent)
    seconds = time.perf_counter() - started
    losses = objective(problem, data, estimate)
    return {
        "seconds": seconds,
        "evaluations": estimate.diagnostics["evaluations"],
        "stopped_by": estimate.diagnostics.get("stopped_by"),
        "means_over_truth": (
            estimate.distribution.mean / hidden_of("hopper", "vanilla").values
        ).tolist(),
        "loss": float(losses.mean()),
        "loss_se": float(losses.std(ddof=1) / np.sqrt(FRESH)),
    }


def objective(problem: Problem, data: TransitionDataset, estimate: Estimate) -> np.ndarray:
    """The loss on fresh draws, (FRESH,), the same for every estimate."""
    replay, d = Replay(problem.task, problem.source, data, DRAWS, 1), len(problem.source.space)
    losses = []
    for seed in range(FRESH):
        levels = qmc.LatinHypercube(d, rng=np.random.default_rng(1000 + seed)).random(DRAWS)
        predictions = replay.predict(estimate.distribution.quantile(levels))
        losses.append(-log_likelihood(predictions, replay.targets, EPSILON))
    return np.array(losses)


if __name__ == "__main__":
    main()
