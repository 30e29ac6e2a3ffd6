"""How long a policy trains until it earns a task's reward threshold, on the ground truth.

    python benchmarks/threshold.py [task, hopper] [preset, paper] [seeds, 3] [name=value …]

The oracle's training of each seed, with a preset's settings (and changes of them), as the service
computes it; as many processes at once as there are cores. Writes build/bench/threshold-TASK-PRESET
as .json (per seed: seconds, CPU seconds, steps and the learning curve) and as .svg.
"""

import json
import math
import os
import statistics
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

from matplotlib.figure import Figure

from adr_service.events import TrainingEvaluated
from adr_service.programs.references import truth_training
from adr_service.progress import Checkpoint
from adr_service.specs import RunSpec
from adr_service.stages.base import compute
from adr_service.tasks.catalogue import get_task
from workers.cluster import worker_environment

FOLDER = Path("build/bench")


def main(task: str = "hopper", preset: str = "paper", seeds: str = "3", *changes: str) -> None:
    environment = {**os.environ, **worker_environment(FOLDER.absolute() / "jax")}

    def one(seed: int) -> dict[str, Any]:
        command = [sys.executable, __file__, "--seed", str(seed), task, preset, *changes]
        done = subprocess.run(
            command, env=environment, stdout=subprocess.PIPE, text=True, check=True
        )
        return json.loads(done.stdout.splitlines()[-1])

    with ThreadPoolExecutor(len(os.sched_getaffinity(0))) as pool:
        found = list(pool.map(one, range(int(seeds))))
    threshold = get_task(task).reward_threshold
    report = {
        "task": task,
        "preset": preset,
        "changes": changes,
        "threshold": threshold,
        "reached": sum(f["reached"] for f in found),
        # None: fewer than half of the seeds reached it
        "median_steps": median([f["steps"] if f["reached"] else math.inf for f in found]),
        "median_seconds": median([f["seconds"] if f["reached"] else math.inf for f in found]),
        "seeds": found,
    }
    FOLDER.mkdir(parents=True, exist_ok=True)
    path = FOLDER / f"{'-'.join(('threshold', task, preset, *changes))}.json"
    path.write_text(json.dumps(report, indent=1))
    draw(report, path.with_suffix(".svg"))
    print(
        f"{task}, {preset}: {report['reached']} of {len(found)} seeds reached {threshold:g}; "
        f"median steps {report['median_steps']}, seconds {report['median_seconds']}; {path}"
    )


def median(values: list[float]) -> float | None:
    middle = statistics.median(values)
    return middle if math.isfinite(middle) else None


def read(value: str) -> Any:
    try:
        return json.loads(value)
    except ValueError:
        return value


def train(seed: str, task: str, preset: str, *changes: str) -> None:
    """One training; its report as the last line of the output."""
    training = {name: read(value) for name, _, value in (c.partition("=") for c in changes)}
    given = {"task": task, "method": "oracle", "preset": preset, "seed": int(seed)}
    spec = RunSpec.model_validate({**given, "training": training})
    started, cpu = time.perf_counter(), time.process_time()

    def progress(fraction: float, checkpoint: Checkpoint | None = None, **facts: Any) -> None:
        if checkpoint is not None:
            point = checkpoint.events[-1]
            assert isinstance(point, TrainingEvaluated)
            seconds, earned = time.perf_counter() - started, point.mean_return
            line = f"seed {seed}: {seconds:.0f} s, {point.steps} steps, return {earned:.1f}"
            print(line, file=sys.stderr, flush=True)

    values = compute(truth_training(spec), progress).values
    report = {
        "seed": int(seed),
        "seconds": time.perf_counter() - started,
        "cpu_seconds": time.process_time() - cpu,
        "steps": values["steps"],
        "reached": values["reached_threshold"],
        "curve": values["curve"],
    }
    print(json.dumps(report))


def draw(report: dict[str, Any], path: Path) -> None:
    figure = Figure(figsize=(7, 4), layout="constrained")
    axes = figure.subplots()
    for found in report["seeds"]:
        steps = [point["steps"] for point in found["curve"]]
        means = [point["mean_return"] for point in found["curve"]]
        axes.plot(steps, means, label=f"seed {found['seed']}")
    axes.axhline(report["threshold"], color="black", linewidth=0.8, linestyle="--")
    axes.set(xlabel="environment steps", ylabel="return on the ground truth")
    axes.set_title(f"{report['task']}, preset {report['preset']}")
    axes.legend(frameon=False)
    figure.savefig(path)


if __name__ == "__main__":
    if sys.argv[1:2] == ["--seed"]:
        train(*sys.argv[2:])
    else:
        main(*sys.argv[1:])
