"""Values for the names that programs in docstrings take from their reader."""

import io
from collections.abc import Generator
from datetime import UTC, datetime
from functools import cache
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import gymnasium
import mujoco
import numpy as np
from fastapi import FastAPI
from mujoco.batch import Batch
from sqlalchemy import create_engine

from adr_service.benchmark.comparison import Outcome
from adr_service.blind_test.cases import draw_blind
from adr_service.blind_test.planting import hide
from adr_service.client import AdrClient
from adr_service.distributions import Gaussian
from adr_service.effects.base import Effect
from adr_service.events import IterationFinished
from adr_service.methods.base import Problem
from adr_service.methods.dropo import Likelihood, deviations
from adr_service.methods.udr import FixedDrSettings
from adr_service.programs import run
from adr_service.progress import silent
from adr_service.search.trust_region import Bounds
from adr_service.simulation.replay import Replay
from adr_service.simulation.vec_env import RandomizedVecEnv
from adr_service.specs import BenchmarkSpec, RunSpec
from adr_service.tasks.catalogue import catalogue, get_task, source_of
from adr_service.training.policy import Policy
from api.settings import Settings
from tests.hidden import arm as arm_and_nominal
from tests.hidden import recorded
from tests.logs.conftest import MAP, XML, motion
from tests.recordings import recording
from tests.stages.examples import policy as policy_with

Names = dict[str, Any]
SPEC = {"task": "arm", "method": "simopt", "preset": "smoke"}
NOW = datetime(2026, 1, 1, tzinfo=UTC)


def an_outcome() -> Outcome:
    spec, space = RunSpec.model_validate(SPEC), source_of("arm", "vanilla").space
    event = IterationFinished(
        iteration=0,
        target_rollouts=0,
        target_transitions=0,
        evaluation_episodes=2,
        distributions=[Gaussian.prior(space).to_json()],
        policies=["p"],
        source_returns=[1.0],
        reached_threshold=[True],
        training_steps=[1],
        inference_steps=0,
        returns=[[1.0, 2.0]],
        diagnostics={},
    )
    return Outcome(spec, event)


def arm(_: Path) -> Names:
    task, source = get_task("arm"), source_of("arm", "vanilla")
    rng = np.random.default_rng(0)
    draws = Gaussian.prior(source.space).sample(12, rng)
    names: Names = {"task": task, "source": source, "space": source.space, "rng": rng}
    return {**names, "draws": draws, "actions": np.zeros((12, 2))}


def arm_file(_: Path) -> Names:
    return {"task": get_task("arm"), "content": recording("arm", 50).to_npz()}


def arm_recording(folder: Path) -> Names:
    names = arm(folder)
    return {**names, "data": recording("arm", 20), "dynamics": names["draws"].values}


def arm_criticised(_: Path) -> Names:
    task, nominal = arm_and_nominal()
    measurement = hide(task, nominal, np.random.default_rng(0), []).episodes(range(8))
    names: Names = {"task": task, "nominal": nominal, "rng": np.random.default_rng(0)}
    return {**names, "measurement": measurement}


def arm_with_an_effect(folder: Path) -> Names:
    names = arm_criticised(folder)
    friction = Effect("joint_coulomb_friction", "joint:elbow", (0.15,))
    data = hide(names["task"], names["nominal"], np.random.default_rng(0), [friction])
    return {**names, "measurement": data.episodes(range(8))}


def simulated(folder: Path) -> Names:
    from adr_service.criticism import responses, scan
    from adr_service.criticism.simulator import Simulator

    names = arm_criticised(folder)
    measurement, nominal = names["measurement"], names["nominal"]
    simulator = Simulator(nominal, measurement, threads=1, finer=3)
    states = np.concatenate([measurement.qpos, measurement.qvel], axis=1)
    names |= {"simulator": simulator, "sensor": measurement.sensor_variance(), "states": states}
    names |= {"parameters": nominal.start, "effects": ()}
    return {**vars(responses), **vars(scan), **names}


def fitted(_: Path) -> Names:
    return {**_fitted(), "rng": np.random.default_rng(0)}


@cache
def _fitted() -> Names:
    from adr_service.criticism import evidence, fits, probable_states

    modules = (fits, evidence, probable_states)
    names = {name: value for module in modules for name, value in vars(module).items()}
    names |= simulated(Path())
    baseline = probable_states.smoothed(fits.fit(names["simulator"], names["sensor"]))
    effect = Effect("joint_coulomb_friction", "joint:elbow", (0.15,))
    return {**names, "baseline": baseline, "effect": effect}


def robots(folder: Path) -> Names:
    """Many arms with a friction that varies."""
    base = mujoco.MjModel.from_xml_string(get_task("arm").xml)
    effect = Effect("joint_load_dependent_friction", "joint:elbow", (0.1,))
    return {
        "base": base,
        "model": base,
        "threads": 1,
        "effects": [effect],
        "starts": np.zeros((5, 4)),
        "control": np.ones((5, 3, 4)),
        "batch": Batch(base, 5, 1),
    }


def scanned(folder: Path) -> Names:
    return {**fitted(folder), **_scanned()}


@cache
def _scanned() -> Names:
    names = _fitted()
    responses = names["Responses"](names["baseline"])
    candidates = names["scan"](names["baseline"], responses)
    return {"responses": responses, "candidates": candidates}


def random_motions(folder: Path) -> Names:
    names = fitted(folder)
    model = names["simulator"].base
    limits = np.tile([-1.0, 1.0], (model.nu, 1))
    return {**names, "fit": names["baseline"], "model": model, "limits": limits, "rows": 50}


def measurement_file(folder: Path) -> Names:
    np.savez(file := io.BytesIO(), **recorded(arm_criticised(folder)["measurement"]))
    return {"path": _written(folder, file.getvalue())}


def recording_file(folder: Path) -> Names:
    return {"path": _written(folder, recording("arm", 20).to_npz())}


def policy_file(folder: Path) -> Names:
    return {
        "path": _written(folder, policy_with((4, 8, 2)).to_bytes()),
        "observations": np.zeros((3, 4)),
    }


def _written(folder: Path, content: bytes) -> Path:
    path = folder / "file"
    path.write_bytes(content)
    return path


def outcomes(_: Path) -> Names:
    return {"outcomes": [an_outcome()]}


def benchmark_spec(_: Path) -> Names:
    grid = {"tasks": ["arm"], "methods": ["udr"], "preset": "smoke"}
    return {"spec": BenchmarkSpec.model_validate(grid)}


def run_spec(_: Path) -> Names:
    from adr_service.stages.local import LocalStages

    return {"spec": RunSpec.model_validate({**SPEC, "method": "prior"}), "LocalStages": LocalStages}


def target(folder: Path) -> Names:
    names = run_spec(folder)
    return {
        "spec": RunSpec.model_validate(SPEC),
        "stages": names["LocalStages"](),
        "policy": policy_with((4, 8, 2)).to_bytes(),
    }


def policy(folder: Path) -> Names:
    from adr_service.stages.evaluate import Evaluate

    return {**target(folder), "Evaluate": Evaluate}


def tasks(_: Path) -> Names:
    return {"catalogue": catalogue}


def stage(_: Path) -> Names:
    return {"stage": SimpleNamespace(digest="0" * 64)}


def parameter_values(_: Path) -> Names:
    return {"values": np.array([4.2])}


def points(_: Path) -> Names:
    rng = np.random.default_rng(0)
    inputs = rng.uniform(size=(8, 2))
    return {"points": inputs, "values": -((inputs - 0.3) ** 2).sum(axis=1), "rng": rng}


def simulations(_: Path) -> Names:
    rng = np.random.default_rng(0)
    inputs = rng.uniform(size=(200, 2))
    seen = np.array([0.4, 0.7])
    return {"d": 2, "rng": rng, "points": inputs, "features": inputs.copy(), "seen": seen}


def loss(_: Path) -> Names:
    return {"np": np, "rng": np.random.default_rng(0), "loss": lambda x: float(x @ x)}


def likelihood(_: Path) -> Names:
    """DROPO's loss of a recording of the arm."""
    source = source_of("arm", "vanilla")
    replay = Replay(get_task("arm"), source, recording("arm", 10), 8, 1)
    levels = np.random.default_rng(0).random((12, len(source.space)))
    low, high = deviations(source.space)
    return {
        "evaluate": Likelihood(source.space, levels, replay, 1e-4).evaluate,
        "measured": replay.targets,
        "epsilon": 1e-4,
        "bounds": Bounds(source.space.low, source.space.high, low, high),
        "mean": (source.space.low + source.space.high) / 2,
        "std": high,
        "silent": silent,
    }


def _rng() -> Names:
    return {"rng": np.random.default_rng(0)}


def hopper_model(_: Path) -> Names:
    return {"spec": mujoco.MjSpec.from_string(get_task("hopper").xml)}


def training(folder: Path) -> Names:
    names = arm(folder)
    settings = RunSpec.model_validate(SPEC).training
    distribution = Gaussian.prior(names["space"])
    observations = np.zeros((3, 4))
    return {**names, "settings": settings, "distribution": distribution} | {
        "observations": observations
    }


def curriculum(folder: Path) -> Names:
    names = arm(folder)
    settings = FixedDrSettings.model_validate({})
    problem = Problem(names["task"], names["source"])
    return {**names, "curriculum": settings.create(problem), "RandomizedVecEnv": RandomizedVecEnv}


def environments(_: Path) -> Names:
    return {"gymnasium": gymnasium}


def server(_: Path) -> Names:
    import uvicorn

    return {"uvicorn": uvicorn, "app": FastAPI(), "settings": Settings()}


def upload(_: Path) -> Names:
    from adr_service.tasks.catalogue import BUILT_IN

    assert "hopper" in BUILT_IN
    return {"content": recording("hopper", 5).to_npz()}


def sessions(folder: Path) -> Names:
    return {"data_dir": folder, "ray": SimpleNamespace(init=lambda **_: None)}


def database_file(folder: Path) -> Names:
    from db.session import open_database

    url = f"sqlite:///{folder / 'adr.sqlite'}"
    open_database(url).close()
    return {"url": url, "connection": create_engine(url).connect()}


def client(service: Any) -> Names:
    """A client of the tests' service, whose benchmarks take seconds."""

    class SmokeClient(AdrClient):
        def submit_benchmark(self, spec: Names, *, dry_run: bool = False) -> Names:
            smoke = {**spec, "preset": "smoke", "seeds": [0]}
            return super().submit_benchmark(smoke, dry_run=dry_run)

    return {"connect": lambda: SmokeClient(service.client.url)}


def exported_run(folder: Path) -> Names:
    """Values that `adr export` has read of a run on Hopper."""
    task = get_task("hopper")
    layer = np.zeros((3, 11), dtype=np.float32), np.zeros(3, dtype=np.float32)
    point = {"training": 0, "steps": 100, "mean_return": 1.0, "standard_error": 0.1}
    row = {"iteration": 0, "normalised_return": 0.5, "policies": 1}
    row |= {"target_transitions": 0, "episodes": 50}
    spec = RunSpec.model_validate({"task": "hopper", "method": "dropo", "preset": "smoke"})
    return {
        "policy": Policy((layer,), "tanh", task.action_low, task.action_high),
        "get_task": get_task,
        "path": folder / "policy.onnx",
        "spec": spec.model_dump(mode="json"),
        "rows": [row],
        "curve": [point],
        "client": SimpleNamespace(curves=lambda _: [point]),
    }


def drive(program: Generator[Any, Any, Any]) -> None:
    """Carry out a program that yields events."""
    for _ in program:
        pass


def archive_file(_: Path) -> Names:
    from adr_service.benchmark.archive import Manifest

    manifest = Manifest(
        benchmark="bench_0123456789abcdef", adr_service="0.1.0", revision="0009", computed_with=[]
    )
    return {"file": io.BytesIO(), "rows": [{"id": "a"}], "content": b"", "manifest": manifest}


def stored_stage(_: Path) -> Names:
    from adr_service.benchmark.replay import replay_run
    from tests.contracts.canned import CannedStages

    stages, spec = CannedStages(), RunSpec.model_validate({**SPEC, "method": "oracle"})
    list(run(spec, stages))
    return {
        "replays": [replay_run("run_a", spec, stages.results.get)],
        "rng": np.random.default_rng(0),
        "is_comparable": lambda stage: stage.kind == "train_policy",
        "stored": next(iter(stages.results.values())),
        "is_same_machine": True,
    }


def finished_database(folder: Path) -> Names:
    from db.session import open_database
    from db.staging import staged
    from tests.db.finished import finished_benchmark

    database = open_database(f"sqlite:///{folder / 'adr.sqlite'}")
    id = finished_benchmark(database)
    names: Names = {"database": database, "benchmark_id": id, "folder": folder, "staged": staged}
    return {**names, "file": io.BytesIO()}


def exported_benchmark(folder: Path) -> Names:
    from db.archives import export_benchmark

    names = finished_database(folder)
    export_benchmark(names["database"], names["benchmark_id"], names["file"])
    return names


def robot_log(folder: Path) -> Names:
    from adr_service.logs.catalogue import read_logs
    from adr_service.logs.conversion import convert
    from adr_service.logs.mapping import LogMap

    columns = motion(np.arange(0.0, 10.0, 0.004))
    table = np.column_stack(list(columns.values()))
    np.savetxt(folder / "run1.csv", table, delimiter=",", header=",".join(columns))
    model = mujoco.MjModel.from_xml_string(XML)
    known = {"read_logs": read_logs, "convert": convert, "LogMap": LogMap, "Path": Path}
    return {**known, "text": MAP, "model": model}


@cache
def _hidden() -> tuple[Any, ...]:
    """Motions without an effect, and what is hidden in a case; they take seconds."""
    motions = hide(*arm_and_nominal(), np.random.default_rng(5), [])
    return motions, *draw_blind("arm", np.random.default_rng([5, 0]))


def blind_test(folder: Path) -> Names:
    """A question in `cases/0000`, an answer in `answers/0000`, and everything to mark it with."""
    from adr_service.blind_test import cases, files, planting, scoring, sizing

    (task, nominal), (motions, hidden, case) = arm_and_nominal(), _hidden()
    key, answer = files.Key(seed=5, cases={"0000": hidden}), files.Answer(verdict="none")
    files.write_question(folder / "cases/0000", case)
    files.write_answer(folder / "answers/0000", answer)
    known = {"task": task, "nominal": nominal, "rng": np.random.default_rng([5, 0]), "Path": Path}
    known |= {"hidden": hidden, "case": case, "key": key, "answer": answer, "folder": folder}
    known |= {"motions": motions}
    for module in (cases, files, planting, scoring, sizing):
        known |= {name: value for name, value in vars(module).items() if callable(value)}
    return known
