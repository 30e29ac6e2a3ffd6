"""Worth of an extended simulator: returns on targets that hide an effect beyond all parameters.

    python -m benchmarks.extension [task, hopper] [seeds, 3] [preset, quick] [force in N, -10]

The target pulls the robot's first body backwards. Criticism names that from a recording (30
episodes of 75 control steps); then DROPO, on one rollout of the prior's policy, with the extension
and without it. Prints mean returns with 95 % intervals over seeds; writes
build/bench/extension.json. With OMP_NUM_THREADS=1, about four minutes a run on Hopper.
"""

import json
import sys
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path

import mujoco
import numpy as np

from adr_service.arrays import Matrix
from adr_service.benchmark.statistics import mean_interval, seed_interval
from adr_service.blind_test.planting import hide
from adr_service.criticism.nominal import Nominal
from adr_service.criticism.pipeline import criticise
from adr_service.effects.base import Effect
from adr_service.events import IterationFinished
from adr_service.programs import run
from adr_service.specs import RunSpec
from adr_service.stages.local import LocalStages
from adr_service.tasks.catalogue import get_task, source_of

FOLDER = Path("build/bench")


def listed(effects: Sequence[Effect]) -> list[dict[str, object]]:
    """Effects as a spec takes them."""
    return [asdict(effect) for effect in effects]


def named(task: str, hidden: Effect) -> list[dict[str, object]]:
    """Effects that criticism names in place of the hidden one."""
    nominal = Nominal.of_task(get_task(task), source_of(task, "vanilla"))
    data = hide(get_task(task), nominal, np.random.default_rng(1), [hidden])
    found = criticise(nominal, data, np.random.default_rng(0), threads=1)
    for cause in found.verdict.causes:
        print(
            cause.kind, cause.location, [(e.name, e.value, e.low, e.high) for e in cause.strengths]
        )
    assert found.extension is not None, "criticism named nothing"
    return listed(found.extension.effects)


def returned(spec: dict[str, object]) -> Matrix:
    """(1, episodes) target returns of the policy at the end of a run."""
    events = run(RunSpec.model_validate(spec), LocalStages())
    last = [event for event in events if isinstance(event, IterationFinished)][-1]
    return np.array(last.returns)


def main(task: str = "hopper", seeds: str = "3", preset: str = "quick", force: str = "-10") -> None:
    first = mujoco.MjModel.from_xml_string(get_task(task).xml).body(1).name
    hidden = Effect("external_force", f"body:{first}", (float(force), 0.0, 0.0))
    spec = {
        "task": task,
        "method": "dropo",
        "collector": "prior",
        "preset": preset,
        "iterations": 1,
        "target": {"kind": "simulated", "effects": listed([hidden])},
    }
    extension = named(task, hidden)
    without: list[Matrix] = []
    extended: list[Matrix] = []
    for seed in range(int(seeds)):
        for found, chosen in ((without, []), (extended, extension)):
            found.append(returned({**spec, "seed": seed, "extension": chosen}))
            print(seed, "extended" if chosen else "as it is", found[-1].mean(), flush=True)
    gained = [float(a.mean() - b.mean()) for a, b in zip(extended, without, strict=True)]
    table = {
        "as it is": mean_interval(without),
        "extended": mean_interval(extended),
        "gained": seed_interval(np.array(gained)),
    }
    for name, each in table.items():
        print(f"{name:10s} {each}, {seeds} seeds")
    FOLDER.mkdir(parents=True, exist_ok=True)
    written = {"spec": spec, "extension": extension} | {n: asdict(e) for n, e in table.items()}
    (FOLDER / "extension.json").write_text(json.dumps(written, indent=1))


if __name__ == "__main__":
    main(*sys.argv[1:])
