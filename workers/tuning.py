"""Ray Tune: the search for the learning rate that trains a task's policies best.

    spec = RunSpec.model_validate({"task": "hopper", "method": "oracle", "preset": "paper"})
    trials = tune(spec, rates=[3e-4, 1e-3], seeds=[0, 1], options=RayOptions())

Every trial is a training on the task's own ground truth (the oracle's), with one learning rate
and one seed. Trials that fall behind are stopped early (asynchronous successive halving, Li et
al. 2020): of three at the same step count, the best goes on. A search of its own, apart from the
service: its best rate becomes a task's default in the code, or a spec's `training`.
"""

import contextlib
import math
import sys
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ray import tune as ray_tune
from ray.tune.schedulers import ASHAScheduler

from adr_service.errors import InvalidInput
from adr_service.events import RunEvent, TrainingEvaluated
from adr_service.programs.references import truth_training
from adr_service.progress import Checkpoint
from adr_service.specs import RunSpec
from adr_service.stages.base import compute
from adr_service.tasks.catalogue import get_task
from adr_service.training.settings import TrainingSettings
from workers.cluster import Cluster, RayOptions

_HALVING = 3


@dataclass(frozen=True)
class Trial:
    """One training of the search."""

    learning_rate: float
    seed: int
    steps: int  # that it trained
    best_return: float | None  # of its evaluations; None where it failed
    reached_threshold: bool
    stopped_early: bool  # it had fallen behind
    error: str | None = None  # a rate may be too high for any training


def tune(
    spec: RunSpec, rates: Sequence[float], seeds: Sequence[int], options: RayOptions
) -> list[Trial]:
    """One trial for every rate and seed, the best first; as many at once as there are cores."""
    if not rates or not all(math.isfinite(rate) and rate > 0 for rate in rates):
        raise InvalidInput(f"learning rates must be positive; given {list(rates)}")
    cluster = Cluster(options)
    cluster.start()
    try:
        with tempfile.TemporaryDirectory() as folder:
            tuner = _tuner(spec, rates, seeds, folder)
            with contextlib.redirect_stdout(sys.stderr):  # Tune announces itself
                results = tuner.fit()
            trials = [_trial(spec, result) for result in results]
    finally:
        cluster.close()
    return sorted(trials, key=_rank)


def _tuner(
    spec: RunSpec, rates: Sequence[float], seeds: Sequence[int], folder: str
) -> ray_tune.Tuner:
    grid = ray_tune.grid_search
    return ray_tune.Tuner(
        ray_tune.with_parameters(_train, spec=spec),
        param_space={
            "learning_rate": grid(sorted(set(rates))),
            "seed": grid(sorted(set(seeds))),
        },
        tune_config=ray_tune.TuneConfig(
            metric="mean_return", mode="max", scheduler=_halving(spec.training)
        ),
        run_config=ray_tune.RunConfig(storage_path=Path(folder).as_uri(), verbose=0),
    )


def _halving(training: TrainingSettings) -> ASHAScheduler:
    """Asynchronous successive halving, that lets each trial be evaluated at least once."""
    most = training.max_steps
    return ASHAScheduler(
        time_attr="steps",
        max_t=most,
        grace_period=min(most, max(training.evaluate_every, most // _HALVING**2)),
        reduction_factor=_HALVING,
    )


def _train(config: dict[str, Any], spec: RunSpec) -> None:
    """A trial, in a process of its own; reports every evaluation."""

    def report(curve: Sequence[RunEvent]) -> None:
        points = [point for point in curve if isinstance(point, TrainingEvaluated)]
        best = max(point.mean_return for point in points)
        latest = points[-1].model_dump(include={"steps", "mean_return", "standard_error"})
        ray_tune.report({**latest, "best_return": best})

    def progress(fraction: float, checkpoint: Checkpoint | None = None, **facts: Any) -> None:
        if checkpoint is not None:
            report(checkpoint.events)

    training = spec.training.model_copy(update={"learning_rate": config["learning_rate"]})
    trial = spec.model_copy(update={"seed": config["seed"], "training": training})
    stage = truth_training(trial)
    report(stage.events(stage.read(compute(stage, progress))))


def _rank(trial: Trial) -> tuple[bool, float]:
    """Sort key: trials that reached the threshold, soonest first; others by return; failed ones."""
    if trial.best_return is None:
        return (True, math.inf)
    return (
        not trial.reached_threshold,
        trial.steps if trial.reached_threshold else -trial.best_return,
    )


def _last_line(error: Exception) -> str:
    return str(error).strip().splitlines()[-1]


def _trial(spec: RunSpec, result: Any) -> Trial:
    if result.error is not None:
        rate, seed = result.config["learning_rate"], result.config["seed"]
        return Trial(rate, seed, 0, None, False, False, _last_line(result.error))
    metrics, threshold = result.metrics, get_task(spec.task).reward_threshold
    reached = metrics["best_return"] >= threshold
    return Trial(
        learning_rate=metrics["config"]["learning_rate"],
        seed=metrics["config"]["seed"],
        steps=metrics["steps"],
        best_return=metrics["best_return"],
        reached_threshold=reached,
        stopped_early=not reached and metrics["steps"] < spec.training.max_steps,
    )
