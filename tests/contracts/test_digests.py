"""Results are a promise: what was stored by earlier versions stays valid.

`digests.json` has the digest of every stage that runs of all methods, tasks, presets and targets
ask for, and the events of one run. A change here makes stored results useless: it needs a bumped
version of the stage's kind, with its reason in docs/decisions.md. ADR_WRITE_GOLDEN=1 writes the
file anew.
"""

import json
import os
from itertools import product
from pathlib import Path

import pytest

from adr_service.json_values import sha256
from adr_service.presets import PRESETS
from adr_service.programs import run
from adr_service.specs import CriticismSpec, RunSpec
from adr_service.transitions import dataset_id
from tests.contracts.canned import CannedStages
from tests.recordings import recording

GOLDEN = Path(__file__).parent / "digests.json"
METHODS = (
    *("udr", "bayrn", "simopt", "simopt_1", "droid", "dropo", "sysid"),
    *("prior", "oracle"),
)
NEWER = ("fixed_dr", "auto_dr", "doraemon", "epopt", "bayes_sim", "npdr")  # than the paper
OFFLINE = ("droid", "dropo", "sysid")
TASKS = ("arm", "hopper", "half_cheetah", "walker2d", "humanoid")
EFFECTS = [{"kind": "joint_coulomb_friction", "location": "joint:elbow", "values": [0.5]}]
RECORDING = recording("arm", 30).to_npz()
# what is installed must not decide what is pinned
BACKENDS = {"backend": "sb3"}
# the trainings of the default preset before it had faster ones: they stay what they were
SAC = {
    "algorithm": "sac",
    "max_steps": 120_000,
    "gradient_steps": 12,
    "learning_rate": 0.001,
    "hidden": [128, 128],
    "activation": "relu",
    "batch_size": 128,
    "learning_starts": 2000,
    "evaluate_every": 5000,
    "evaluation_episodes": 24,
}


def specs():
    """Runs by a name that says what each is."""
    for preset, method in product((p for p in PRESETS if p != "fast"), METHODS):
        yield f"{method} {preset}", {"task": "arm", "method": method, "preset": preset}
    for task, variant, method in product(TASKS, ("vanilla", "noisy", "unmodeled"), METHODS):
        name = f"{method} on {task} {variant}"
        given = {"task": task, "variant": variant, "method": method, "iterations": 2}
        yield name, {**given, "training": SAC}
    for task, method in product(TASKS, METHODS):
        yield f"{method} on {task} fast", {"task": task, "method": method, "preset": "fast"}
    small = {"task": "arm", "preset": "smoke", "iterations": 3, "seed": 7}
    for method, collector in product(OFFLINE, ("prior", "random", "random_matched")):
        yield f"{method} on {collector}", {**small, "method": method, "collector": collector}
    for method in METHODS:
        yield f"{method} extended", {**small, "method": method, "extension": EFFECTS}
        target = {"kind": "simulated", "effects": EFFECTS}
        yield f"{method} with hidden effects", {**small, "method": method, "target": target}
    for method in METHODS[:-1]:
        yield f"{method} with a robot", {**small, "method": method, "target": {"kind": "external"}}
    target = {"kind": "recorded", "dataset": dataset_id(RECORDING)}
    for method in OFFLINE:
        yield f"{method} of a recording", {**small, "method": method, "target": target}
    for method in NEWER:
        yield f"{method} small", {**small, "method": method}
        yield f"{method} on hopper fast", {"task": "hopper", "method": method, "preset": "fast"}
    for method in OFFLINE:
        yield f"{method} of smoothed states", {**small, "method": f"{method}_smoothed"}
    yield "simopt of all trajectories", {**small, "method": "simopt_memory"}
    grid = {"name": "dropo", "epsilon": [1e-5, 1e-3], "samples_per_parameter": 3}
    own = {"name": "simopt", "samples": 33, "updates": 2}
    yield "dropo with settings", {**small, "method": grid, "simopt": own}
    faster = {"backend": "sbx", "learning_rate": 0.002, "max_steps": 300}
    yield "simopt by sbx", {**small, "method": own, "training": faster}


def asked(spec, content=None):
    """Kinds and digests of the stages that a run asks for, in order, and its events."""
    stages = CannedStages()
    events = list(run(spec, stages, content))
    return stages.asked, events


def asked_by_name():
    found = {}
    for name, given in specs():
        training = BACKENDS | given.get("training", {})
        spec = RunSpec.model_validate({**given, "training": training})
        stages, _ = asked(spec, RECORDING if spec.dataset else None)
        found[name] = {
            "stages": {kind: sum(k == kind for k, _ in stages) for kind, _ in stages},
            "digest": sha256("\n".join(f"{k} {d}" for k, d in stages).encode()),
        }
    return found


_LISTED = (
    *(" smoke", " with a robot", " of a recording", " of smoothed states", "trajectories"),
    *("with settings", "sbx"),
)


def listed():
    """Every stage of some runs, so that one sees which kind's digests differ."""
    found = {}
    for name, given in specs():
        if name.endswith(_LISTED):
            training = BACKENDS | given.get("training", {})
            spec = RunSpec.model_validate({**given, "training": training})
            stages, _ = asked(spec, RECORDING if spec.dataset else None)
            found[name] = [f"{kind} {digest}" for kind, digest in stages]
    criticism = CriticismSpec.model_validate({"task": "arm", "dataset": "data_0", "seed": 3})
    found["criticism"] = [f"{k} {d}" for k, d in asked(criticism, b"measured")[0]]
    return found


def events():
    """The events of one run of four programs, as they are stored."""
    small = {"task": "arm", "preset": "smoke", "training": BACKENDS}
    given = [{**small, "method": method} for method in ("bayrn", "simopt", "dropo")]
    found = [asked(RunSpec.model_validate(each))[1] for each in given]
    criticism = CriticismSpec.model_validate({"task": "arm", "dataset": "data_0", "seed": 3})
    found.append(asked(criticism, b"measured")[1])
    return [event.key + " " + event.model_dump_json() for each in found for event in each]


@pytest.fixture(scope="module")
def golden():
    if os.environ.get("ADR_WRITE_GOLDEN"):
        found = {"runs": asked_by_name(), "stages": listed(), "events": events()}
        GOLDEN.write_text(json.dumps(found, indent=1) + "\n")
    return json.loads(GOLDEN.read_text())


def test_every_kind_of_stage_keeps_its_digests(golden):
    assert listed() == golden["stages"]


def test_every_method_task_preset_and_target_asks_for_the_same_stages(golden):
    found = asked_by_name()
    changed = [name for name in golden["runs"] if found.get(name) != golden["runs"][name]]
    assert not changed
    assert found.keys() == golden["runs"].keys()


def test_events_are_written_as_they_were(golden):
    assert events() == golden["events"]
