"""Ray Tune: the search for the settings that train a task's policies soonest.

    spec = {"task": "hopper", "method": "oracle", "preset": "fast"}
    grid = {"learning_rate": [3e-4, 1e-3], "epochs": [5, 10]}
    trials = tune(spec, grid, seeds=[0, 1], options=RayOptions())

Every trial is a training of the oracle's policy (on the task's ground truth) or of the prior's,
with one combination of settings and one seed. Trials that fall behind are stopped early
(asynchronous successive halving, Li et al. 2020): of three that have used the same CPU time, the
best goes on. A search of its own, apart from the service: what it finds becomes a preset in the
code, or a spec's `training`.
"""

import contextlib
import statistics
import sys
import tempfile
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from typing import Any

from pydantic import ValidationError
from ray import tune as ray_tune
from ray.tune.schedulers import ASHAScheduler

from adr_service.errors import InvalidInput
from adr_service.events import RunEvent, TrainingEvaluated
from adr_service.json_values import canonical_json, explain
from adr_service.programs.references import reference_training
from adr_service.progress import Checkpoint
from adr_service.specs import RunSpec
from adr_service.stages.base import compute
from workers.cluster import Cluster, RayOptions

_HALVING = 3
Changes = dict[str, Any]  # settings of a training, by name


@dataclass(frozen=True)
class Trial:
    """One training of the search."""

    changes: Changes  # the settings that it tries
    seed: int
    steps: int  # that it trained
    cpu_seconds: float  # of its process, with imports and compilations
    best_return: float | None  # of its evaluations; None where it failed
    reached_threshold: bool
    stopped_early: bool  # it had fallen behind, or used its CPU time
    error: str | None = None  # settings may be such that no training succeeds


@dataclass(frozen=True)
class Candidate:
    """The trials of one combination of settings, one for each seed."""

    trials: Sequence[Trial]

    @property
    def changes(self) -> Changes:
        return self.trials[0].changes

    @property
    def reached(self) -> int:
        """The number of trials that reached the threshold."""
        return sum(trial.reached_threshold for trial in self.trials)

    @property
    def cpu_seconds(self) -> list[float]:
        """CPU seconds of the trials that reached the threshold, in order."""
        return sorted(t.cpu_seconds for t in self.trials if t.reached_threshold)

    @property
    def returns(self) -> list[float]:
        """The best returns of trials that did not fail, in order."""
        return sorted(t.best_return for t in self.trials if t.best_return is not None)

    @property
    def rank(self) -> tuple[float, ...]:
        """Sort key: most trials at the threshold, then the soonest, then the largest returns."""
        median = statistics.median(self.cpu_seconds) if self.reached else 0.0
        best = statistics.median(self.returns) if self.returns else -sys.float_info.max
        return (-self.reached, median, -best)


def candidates(trials: Sequence[Trial]) -> list[Candidate]:
    """The trials by what they try, the best first."""
    groups: dict[str, list[Trial]] = {}
    for trial in trials:
        groups.setdefault(canonical_json(trial.changes), []).append(trial)
    return sorted((Candidate(group) for group in groups.values()), key=lambda each: each.rank)


def tune(
    given: Mapping[str, Any],
    grid: Mapping[str, Sequence[Any]],
    seeds: Sequence[int],
    options: RayOptions,
    cpu_seconds: float = 600.0,
) -> list[Trial]:
    """One trial for every combination of the grid's settings and every seed.

    `given` is a run's spec, of method `oracle` or `prior`. As many trials run at once as there are
    cores, none for longer than `cpu_seconds`.
    """
    trainings = [_spec(given, changes, seed) for changes in _combinations(grid) for seed in seeds]
    cluster = Cluster(options)
    cluster.start()
    try:
        with tempfile.TemporaryDirectory() as folder:
            tuner = _tuner(given, grid, seeds, folder, cpu_seconds)
            with contextlib.redirect_stdout(sys.stderr):  # Tune announces itself
                results = tuner.fit()
            found = [_trial(result) for result in results]
    finally:
        cluster.close()
    assert len(found) == len(trainings)
    return found


def _combinations(grid: Mapping[str, Sequence[Any]]) -> list[Changes]:
    return [dict(zip(grid, values, strict=True)) for values in product(*grid.values())]


def _spec(given: Mapping[str, Any], changes: Changes, seed: int) -> RunSpec:
    """The run that a trial trains a policy of. Raises InvalidInput."""
    try:
        RunSpec.model_validate({**given, "seed": seed})  # so that its training is an object
        own = given.get("training", {})
        if twice := sorted(own.keys() & changes.keys()):
            raise InvalidInput(f"training.{twice[0]} is given, and searched as well; choose one")
        return RunSpec.model_validate({**given, "training": {**own, **changes}, "seed": seed})
    except ValidationError as error:
        raise InvalidInput(f"{changes}: {explain(error, 'spec')}") from error


def _tuner(
    given: Mapping[str, Any],
    grid: Mapping[str, Sequence[Any]],
    seeds: Sequence[int],
    folder: str,
    cpu_seconds: float,
) -> ray_tune.Tuner:
    halving = ASHAScheduler(
        time_attr="cpu_seconds",
        max_t=int(cpu_seconds),
        grace_period=max(1, int(cpu_seconds / _HALVING**2)),
        reduction_factor=_HALVING,
    )
    return ray_tune.Tuner(
        ray_tune.with_parameters(_train, given=given),
        param_space={
            "changes": ray_tune.grid_search(_combinations(grid)),
            "seed": ray_tune.grid_search(list(seeds)),
        },
        tune_config=ray_tune.TuneConfig(metric="mean_return", mode="max", scheduler=halving),
        run_config=ray_tune.RunConfig(storage_path=Path(folder).as_uri(), verbose=0),
    )


def _train(config: dict[str, Any], given: Mapping[str, Any]) -> None:
    """A trial, in a process of its own; reports every evaluation."""

    def report(curve: Sequence[RunEvent], reached: bool = False, finished: bool = False) -> None:
        points = [point for point in curve if isinstance(point, TrainingEvaluated)]
        latest = points[-1].model_dump(include={"steps", "mean_return"})
        best = max(point.mean_return for point in points)
        state = {"reached_threshold": reached, "finished": finished}
        used = time.process_time()
        ray_tune.report({**latest, **state, "cpu_seconds": used, "best_return": best})

    def progress(fraction: float, checkpoint: Checkpoint | None = None, **facts: Any) -> None:
        if checkpoint is not None:
            report(checkpoint.events)

    stage = reference_training(_spec(given, config["changes"], config["seed"]))
    trained = stage.read(compute(stage, progress))
    report(stage.events(trained), trained.reached_threshold, finished=True)


def _last_line(error: Exception) -> str:
    return str(error).strip().splitlines()[-1]


def _trial(result: Any) -> Trial:
    changes, seed = result.config["changes"], result.config["seed"]
    if result.error is not None:
        return Trial(changes, seed, 0, 0.0, None, False, False, _last_line(result.error))
    metrics = result.metrics
    return Trial(
        changes=changes,
        seed=seed,
        steps=metrics["steps"],
        cpu_seconds=metrics["cpu_seconds"],
        best_return=metrics["best_return"],
        reached_threshold=metrics["reached_threshold"],
        stopped_early=not metrics["finished"],
    )
