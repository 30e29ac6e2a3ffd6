"""CPU seconds and environment steps until a policy earns its task's reward threshold.

    python benchmarks/threshold.py [TASK …] [--preset P …] [--on truth] [--seeds N] [--first-seed K]
                                   [--seconds S] [--set NAME=VALUE …]

Trains as the service does, the oracle's policy (`--on truth`) or the prior's (`--on prior`), on as
many seeds at once as there are cores. Without tasks, on all four of the benchmark. With
`--seconds`, trainings go on after the threshold, until they have used so many CPU seconds, for
comparisons of presets; they have reached it with the first evaluation that earns it, without
confirmation. Every training is kept in build/bench/threshold, so that a study that was stopped goes
on where it was. Writes there, per task, a report (.json) and the learning curves (.svg), and prints
a table.

CPU seconds are those of the training's process, with its imports and compilations.
"""

import argparse
import contextlib
import json
import math
import os
import statistics
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from itertools import product
from pathlib import Path
from typing import Any

from matplotlib.figure import Figure

from adr_service.events import TrainingEvaluated
from adr_service.programs.references import reference_training
from adr_service.progress import Checkpoint, StageCancelled
from adr_service.specs import RunSpec
from adr_service.stages.base import compute
from adr_service.stages.train_policy import TrainPolicy
from adr_service.tasks.catalogue import get_task
from api.specs import assign
from workers.cluster import worker_environment

FOLDER = Path("build/bench/threshold")
TASKS = ("hopper", "half_cheetah", "walker2d", "humanoid")


def options() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("tasks", nargs="*", default=list(TASKS))
    parser.add_argument("--preset", nargs="+", default=["fast"])
    parser.add_argument("--on", choices=("truth", "prior"), default="truth")
    parser.add_argument("--seeds", type=int, default=5)
    parser.add_argument("--first-seed", type=int, default=0)
    parser.add_argument("--seconds", type=int, help="train for so long, past the threshold")
    parser.add_argument("--set", action="append", default=[], metavar="NAME=VALUE")
    parser.add_argument("--seed", type=int, help="train this one alone, in this process")
    return parser.parse_args()


def main(given: argparse.Namespace) -> None:
    FOLDER.mkdir(parents=True, exist_ok=True)
    seeds = range(given.first_seed, given.first_seed + given.seeds)
    trainings = list(product(given.tasks, seeds, given.preset))
    with ThreadPoolExecutor(len(os.sched_getaffinity(0))) as pool:
        list(pool.map(lambda each: in_a_process_of_its_own(given, *each), trainings))
    print(
        "| task | preset | reached | CPU seconds: median, range | steps: median, range | return |"
    )
    for task in given.tasks:
        found = {
            preset: [json.loads(kept(given, task, seed, preset).read_text()) for seed in seeds]
            for preset in given.preset
        }
        seconds = () if given.seconds is None else (f"{given.seconds}s",)
        first = () if given.first_seed == 0 else (f"from-{given.first_seed}",)
        name = "-".join([task, *given.preset, given.on, *given.set, *seconds, *first])
        (FOLDER / f"{name}.json").write_text(json.dumps(found, indent=1))
        draw(task, given, found, FOLDER / f"{name}.svg")
        for preset, reports in found.items():
            print(row(task, preset, reports), flush=True)


def in_a_process_of_its_own(given: argparse.Namespace, task: str, seed: int, preset: str) -> None:
    """Train, unless it has been done."""
    if kept(given, task, seed, preset).exists():
        return
    environment = {**os.environ, **worker_environment(Path("build/bench/jax").absolute())}
    command = [sys.executable, "-W", "ignore::DeprecationWarning", __file__, task]
    command += ["--preset", preset, "--on", given.on, "--seed", str(seed)]
    command += [argument for each in given.set for argument in ("--set", each)]
    command += [] if given.seconds is None else ["--seconds", str(given.seconds)]
    subprocess.run(command, env=environment, check=True)


def stage_of(given: argparse.Namespace, task: str, seed: int, preset: str) -> TrainPolicy:
    method = {"truth": "oracle", "prior": "prior"}[given.on]
    spec = {"task": task, "method": method, "preset": preset, "seed": seed}
    assign(spec, (f"training.{each}" for each in given.set))
    if given.seconds is not None:
        assign(spec, ["training.stop_at_threshold=false"])
    return reference_training(RunSpec.model_validate(spec))


def kept(given: argparse.Namespace, task: str, seed: int, preset: str) -> Path:
    seconds = "" if given.seconds is None else f"-{given.seconds}s"
    return FOLDER / f"{stage_of(given, task, seed, preset).digest}{seconds}.json"


def train(given: argparse.Namespace) -> None:
    """One training; keeps its report."""
    (task,), (preset,) = given.tasks, given.preset
    stage = stage_of(given, task, given.seed, preset)
    curve: list[dict[str, float]] = []

    def progress(fraction: float, checkpoint: Checkpoint | None = None, **facts: Any) -> None:
        if checkpoint is not None:
            point = checkpoint.events[-1]
            assert isinstance(point, TrainingEvaluated)
            seen = point.model_dump(include={"steps", "mean_return", "standard_error"})
            curve.append({"cpu_seconds": time.process_time(), **seen})
            line = f"{task}, {preset}, seed {given.seed}: {curve[-1]['cpu_seconds']:.0f} CPU s, "
            line += f"{point.steps} steps, return {point.mean_return:.1f}"
            print(line, file=sys.stderr, flush=True)
            if given.seconds is not None and time.process_time() > given.seconds:
                raise StageCancelled

    values: dict[str, Any] = {}
    with contextlib.suppress(StageCancelled):
        values = compute(stage, progress).values
    report = {
        "task": task,
        "seed": given.seed,
        "training": stage.training.model_dump(),
        **(
            outcome_of_result(values)
            if given.seconds is None
            else outcome_by_evaluations(task, curve)
        ),
        "confirmation": values.get("confirmation"),
        "diverged_episodes": values.get("diverged_episodes"),
        "curve": curve,
    }
    kept(given, task, given.seed, preset).write_text(json.dumps(report, indent=1))


def outcome_of_result(values: dict[str, Any]) -> dict[str, Any]:
    return {
        "cpu_seconds": time.process_time(),
        "steps": values["steps"],
        "reached": values["reached_threshold"],
        "source_return": values["source_return"],
    }


def outcome_by_evaluations(task: str, curve: list[dict[str, float]]) -> dict[str, Any]:
    """The outcome of a training that has so much time: its first point at the threshold."""
    earned = [each for each in curve if each["mean_return"] >= get_task(task).reward_threshold]
    point = earned[0] if earned else max(curve, key=lambda each: each["mean_return"])
    return {
        "cpu_seconds": point["cpu_seconds"],
        "steps": point["steps"],
        "reached": bool(earned),
        "source_return": point["mean_return"],
    }


def row(task: str, preset: str, found: list[dict[str, Any]]) -> str:
    reached = [each for each in found if each["reached"]]
    cells = [task, preset, f"{len(reached)} of {len(found)} seeds"]
    for name, unit in (("cpu_seconds", 1), ("steps", 1000)):
        values = [each[name] / unit if each["reached"] else math.inf for each in found]
        numbers = (statistics.median(values), min(values), max(values))
        median, least, most = ("–" if math.isinf(n) else f"{n:.0f}" for n in numbers)
        cells.append(f"{median}, {least} to {most}" + (" thousand" if unit > 1 else ""))
    returns = sorted(each["source_return"] for each in found)
    cells.append(f"{returns[0]:.0f} to {returns[-1]:.0f}")
    return f"| {' | '.join(cells)} |"


def draw(
    task: str, given: argparse.Namespace, found: dict[str, list[dict[str, Any]]], path: Path
) -> None:
    """The learning curves, coloured by preset where there are several, else by seed."""
    figure = Figure(figsize=(7, 4), layout="constrained")
    axes = figure.subplots()
    for i, (preset, each) in enumerate(
        (p, each) for p, reports in found.items() for each in reports
    ):
        several = len(found) > 1
        color = f"C{given.preset.index(preset) if several else i}"
        begins = each["seed"] == given.first_seed
        label = (preset if begins else None) if several else f"seed {each['seed']}"
        seconds, means, errors = (
            [point[name] for point in each["curve"]]
            for name in ("cpu_seconds", "mean_return", "standard_error")
        )
        axes.plot(seconds, means, label=label, linewidth=1, color=color)
        low = [mean - error for mean, error in zip(means, errors, strict=True)]
        high = [mean + error for mean, error in zip(means, errors, strict=True)]
        axes.fill_between(seconds, low, high, color=color, alpha=0.3, linewidth=0)
        if each["reached"]:
            axes.plot(each["cpu_seconds"], each["source_return"], "o", color=color)
    axes.axhline(get_task(task).reward_threshold, color="black", linewidth=0.8, linestyle="--")
    axes.set(xlabel="CPU seconds", ylabel=f"return on the {given.on}, with one standard error")
    axes.set_title(f"{task}, preset {' and '.join(given.preset)}")
    axes.legend(frameon=False)
    figure.savefig(path)


if __name__ == "__main__":
    arguments = options()
    if arguments.seed is None:
        main(arguments)
    else:
        train(arguments)
