"""Recovery of the hidden truth by every method that infers a distribution.

    python benchmarks/recovery.py [--tasks T …] [--variants V …] [--methods M …]
                                  [--data random prior] [--seeds N] [--kept]

Each cell records 200 transitions on the simulated target, by random actions or by the policy that
the preset `fast` trains on the prior (in as many episodes as it takes), and infers once, with the
method's default settings. SimOpt simulates the policy, so it has no cell with random actions;
Humanoid has no smoothed states. Every policy is kept in build/bench/recovery and every cell in
docs/recovery.jsonl, so that a study that was stopped goes on where it was. Prints a table of
medians over seeds:

    distance      root mean square over parameters of the estimate's mean from the truth, in [0, 4]
    log_score     log density of the truth under the estimate [nat], and under the prior; for DROPO
                  under the Gaussian of its mean and deviations; none for a point, a box or samples
                  (sysid, sysid_wide, npdr)
    loss          DROPO's negative log likelihood per transition, which is always simulated, and
                  what its model had predicted for it
    at_bound      number of parameters whose mean is at a bound of the search, and of those whose
                  deviation is as wide as it may be
    steps, cpu_seconds      control steps simulated; of all values of a grid together
"""

import argparse
import json
import os
import statistics
import sys
import time
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import asdict, dataclass
from itertools import groupby, product
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np

from adr_service.benchmark.truth import estimation_error, log_score
from adr_service.distributions import Gaussian, normalised_std
from adr_service.json_values import sha256
from adr_service.methods.base import OnlineSettings
from adr_service.methods.catalogue import method_inputs, methods, names_of
from adr_service.programs.references import prior_training
from adr_service.programs.steps import infer, problem_of, source_inputs
from adr_service.specs import RunSpec
from adr_service.stages.base import AnyStage, compute
from adr_service.stages.infer import Infer
from adr_service.stages.local import LocalStages, drained
from adr_service.stages.smooth_states import SmoothStates
from adr_service.stages.target_rollout import TargetRollout
from adr_service.tasks.catalogue import task_inputs, variant_of
from adr_service.transitions import TransitionDataset
from workers.cluster import worker_environment

FOLDER = Path("build/bench/recovery")
KEPT = Path("docs/recovery.jsonl")
TASKS = ("hopper", "half_cheetah", "walker2d", "humanoid")
VARIANTS = ("vanilla", "noisy", "unmodeled", "edge", "outside")
DATA = ("random", "prior")
TRANSITIONS = 200
UNSMOOTHABLE = ("humanoid",)  # criticism knows slides and hinges alone
COLUMNS = (
    "task",
    "variant",
    "data",
    "method",
    "distance",
    "prior's",
    "log score",
    "prior's",
    "loss, predicted",
    "at bound: means, deviations",
    "million steps",
    "CPU s",
)


@dataclass(frozen=True)
class Cell:
    task: str
    variant: str
    data: str  # who acts: random or prior
    method: str
    seed: int

    @property
    def is_possible(self) -> bool:
        """False for an online method without a policy, and for states that cannot be smoothed."""
        settings = methods()[self.method]
        if settings.replay_from == "smoothed" and self.task in UNSMOOTHABLE:
            return False
        return self.data == "prior" or settings.learns_from == "recordings"

    @property
    def key(self) -> str:
        """The name of the row, which changes with the settings and versions of all its stages."""
        return key_of(self.spec, prior_training(self.spec) if self.data == "prior" else None)

    @property
    def spec(self) -> RunSpec:
        names = {name: getattr(self, name) for name in ("task", "variant", "method", "seed")}
        return RunSpec.model_validate({**names, "preset": "fast"})


def options() -> argparse.Namespace:
    inferring = [*names_of("visits"), *names_of("recordings")]
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    for name, known, usual in (
        ("tasks", TASKS, TASKS),
        ("variants", VARIANTS, VARIANTS[:3]),  # the paper's
        ("methods", inferring, inferring),
        ("data", DATA, DATA),
    ):
        parser.add_argument(f"--{name}", nargs="+", choices=known, default=usual)
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--kept", action="store_true", help="print what there is, compute nothing")
    return parser.parse_args()


def main(given: argparse.Namespace) -> None:
    FOLDER.mkdir(parents=True, exist_ok=True)
    os.environ.update(worker_environment(Path("build/bench/jax").absolute()))
    wanted = {cell.key: cell for cell in cells(given)}
    known = {row["key"]: row for row in map(json.loads, lines_of(KEPT))}
    missing = [] if given.kept else [c for key, c in wanted.items() if key not in known]
    acted = {prior_training(c.spec).digest: c.spec for c in missing if c.data == "prior"}
    with ProcessPoolExecutor(
        len(os.sched_getaffinity(0)), mp_context=get_context("spawn"), max_tasks_per_child=1
    ) as pool:
        list(pool.map(policy_of, acted.values()))
        for done in as_completed([pool.submit(measured, cell) for cell in missing]):
            row = done.result()
            with KEPT.open("a") as file:
                file.write(json.dumps(row) + "\n")
            known[row["key"]] = row
    rows = sorted((known[key] for key in wanted if key in known), key=where)
    print(f"| {' | '.join(COLUMNS)} |\n|{'---|' * len(COLUMNS)}")
    for _, group in groupby(rows, key=where):
        print(line(list(group)))


def cells(given: argparse.Namespace) -> Iterator[Cell]:
    """All cells, seeds outermost, so that a stopped study has whole repetitions."""
    for seed in range(given.seeds):
        for names in product(given.tasks, given.variants, given.data, given.methods):
            cell = Cell(*names, seed)
            if cell.is_possible:
                yield cell


def measured(cell: Cell) -> dict[str, Any]:
    """The row of a cell."""
    spec = cell.spec
    policy = policy_of(spec) if cell.data == "prior" else None
    row = {"key": cell.key, **asdict(cell), **inferred(spec, recorded(spec, policy), policy)}
    print(row, file=sys.stderr, flush=True)
    return row


def lines_of(path: Path) -> list[str]:
    return path.read_text().splitlines() if path.exists() else []


def key_of(spec: RunSpec, training: AnyStage | None) -> str:
    """A digest of the stages of an inference, as far as they are known before any is computed."""
    stages: list[AnyStage] = [rollout_of(spec, TRANSITIONS, 0, None)]
    if training is not None:
        stages.append(training)
    if spec.method.replay_from == "smoothed":
        stages.append(SmoothStates(**source_inputs(spec), data=b""))
    for settings in spec.method.each:
        stages.append(Infer(**source_inputs(spec), **method_inputs(settings), data=b""))
    return sha256("".join(stage.digest for stage in stages).encode())[:16]


def policy_of(spec: RunSpec) -> bytes:
    """The policy that the preset trains on the prior, trained unless it was before."""
    stage = prior_training(spec)
    path = FOLDER / f"{stage.digest}.policy"
    if not path.exists():
        keep(path, stage.read(compute(stage)).policy)
    return path.read_bytes()


def keep(path: Path, content: bytes) -> None:
    """Write a file as a whole or not at all."""
    unfinished = path.with_suffix(f".{os.getpid()}")
    unfinished.write_bytes(content)
    unfinished.replace(path)


def recorded(spec: RunSpec, policy: bytes | None) -> bytes:
    """As many episodes as it takes to record the transitions."""
    parts: list[TransitionDataset] = []
    while (missing := TRANSITIONS - sum(map(len, parts))) > 0:
        rollout = rollout_of(spec, missing, len(parts), policy)
        parts.append(TransitionDataset.from_npz(rollout.read(compute(rollout)).data))
    return TransitionDataset.concatenate(parts).to_npz()


def rollout_of(spec: RunSpec, transitions: int, number: int, policy: bytes | None) -> TargetRollout:
    return TargetRollout(
        **task_inputs(spec.task),
        variant=spec.target_domain,
        seed=spec.seed,
        transitions=transitions,
        iteration=number,
        policy=policy,
    )


def inferred(spec: RunSpec, data: bytes, policy: bytes | None) -> dict[str, Any]:
    """Quality and cost of a method's answer."""
    method, state = spec.method, None
    if isinstance(method, OnlineSettings):
        state = method.create().start(problem_of(spec))
    else:
        policy = None  # an offline method sees the data alone
    started = time.process_time()
    answer = drained(infer(spec, LocalStages(), data=data, policy=policy, state=state)).answer
    seconds = time.process_time() - started
    pair, estimate = variant_of(spec.task, spec.variant), answer.distribution
    prior, facts = Gaussian.prior(pair.source.space), answer.diagnostics
    return {
        "distance": estimation_error(spec.task, spec.variant, estimate.mean),
        "prior_distance": estimation_error(spec.task, spec.variant, prior.mean),
        "posterior_std": float(np.sqrt(np.mean(normalised_std(estimate) ** 2))),
        "log_score": log_score(spec.task, spec.variant, estimate),
        "prior_log_score": log_score(spec.task, spec.variant, prior),
        "epsilon": facts.get("epsilon"),
        "loss": facts.get("loss_per_window"),
        "predicted_loss": facts.get("predicted_loss_per_window"),
        "stopped_by": facts.get("stopped_by"),
        "at_bound": [len(facts["at_bound"]), len(facts.get("widest", []))],
        "steps": answer.simulated_steps,
        "cpu_seconds": round(seconds, 1),
    }


def where(row: dict[str, Any]) -> tuple[int, int, str, str]:
    place = TASKS.index(row["task"]), VARIANTS.index(row["variant"])
    return *place, row["data"], row["method"]


def line(rows: list[dict[str, Any]]) -> str:
    """One line of the table: medians, and the range of the distance."""

    def median(name: str, unit: float = 1.0) -> float:
        return statistics.median(row[name] / unit for row in rows)

    distances = [row["distance"] for row in rows]
    scored = all(row["log_score"] is not None for row in rows)
    simulated = all(row["predicted_loss"] is not None for row in rows)
    first = rows[0]
    reach = "1 seed"
    if len(rows) > 1:
        reach = f"{min(distances):.3f} to {max(distances):.3f}, {len(rows)} seeds"
    parts = [
        first["task"],
        first["variant"],
        first["data"],
        first["method"],
        f"{median('distance'):.3f} ({reach})",
        f"{median('prior_distance'):.2f}",
        f"{median('log_score'):.4g}" if scored else "",
        f"{median('prior_log_score'):.1f}",
        f"{median('loss'):.2f}, {median('predicted_loss'):.2f}" if simulated else "",
        ", ".join(f"{sum(r['at_bound'][i] for r in rows) / len(rows):.1f}" for i in (0, 1)),
        f"{median('steps', 1e6):.2f}",
        f"{median('cpu_seconds'):.0f}",
    ]
    return f"| {' | '.join(parts)} |"


if __name__ == "__main__":
    main(options())
