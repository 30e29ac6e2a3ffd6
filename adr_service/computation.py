"""What each kind of stage computes: JSON and bytes in, JSON and bytes out."""

from collections.abc import Callable, Generator, Mapping, Sequence
from dataclasses import asdict, replace
from typing import Any

import numpy as np

from adr_service.criticism.measurements import Measurement
from adr_service.criticism.simulator import Nominal
from adr_service.distributions import Uniform, distribution_from_json
from adr_service.errors import InvalidInput
from adr_service.events import RunEvent
from adr_service.methods.base import Evidence, OfflineSettings, OnlineSettings, Problem
from adr_service.methods.bayrn import propose
from adr_service.methods.catalogue import parse_settings
from adr_service.progress import Progress, silent
from adr_service.randomness import stream
from adr_service.simulation.rollout import random_actions
from adr_service.stages import KINDS, Stage, StageResult, events_of
from adr_service.startup_time import preparing
from adr_service.target import simulate_evaluation, simulate_rollout
from adr_service.tasks.catalogue import get_task, source_of
from adr_service.training.policy import Policy
from adr_service.training.settings import TrainingSettings
from adr_service.transitions import TransitionDataset

Inputs = Mapping[str, Any]
Blobs = Mapping[str, bytes]


def compute(stage: Stage, progress: Progress = silent) -> StageResult:
    """Run a stage here and now; its random numbers come from its digest."""
    if KINDS[stage.kind].role == "robot":
        raise InvalidInput("a target outside needs the service, from which its client takes tasks")
    rng = stream("stage", stage.digest)
    return _FUNCTIONS[stage.kind](stage.inputs, stage.blobs, rng, progress)


class LocalStages:
    """Runs stages in this process, one after the other, and remembers them by digest."""

    run_id = "local"

    def __init__(self) -> None:
        self._memory: dict[str, StageResult] = {}
        self.executed: list[Stage] = []

    def all(self, stages: Sequence[Stage]) -> Generator[RunEvent, None, list[StageResult]]:
        results: list[StageResult] = []
        for stage in stages:
            if stage.digest not in self._memory:
                self._memory[stage.digest] = compute(stage)
                self.executed.append(stage)
            result = self._memory[stage.digest]
            yield from events_of(stage, result)
            results.append(result)
        return results

    def run(self, stage: Stage) -> Generator[RunEvent, None, StageResult]:
        return (yield from self.all([stage]))[0]


def _train_policy(
    inputs: Inputs, blobs: Blobs, rng: np.random.Generator, progress: Progress
) -> StageResult:
    # importing PyTorch and JAX takes seconds: only who trains pays
    with preparing():
        from adr_service.training.sac import train

    task = get_task(inputs["task"])
    source = source_of(task.name, inputs["variant"])
    training = train(
        task,
        source,
        distribution_from_json(source.space, inputs["distribution"]),
        TrainingSettings.model_validate(inputs["training"]),
        rng,
        progress,
    )
    return StageResult(
        {
            "steps": training.steps,
            "source_return": training.best.mean_return,
            "reached_threshold": training.best.mean_return >= task.reward_threshold,
            "curve": [asdict(point) for point in training.curve],
            "adjusted_draws": training.adjusted_draws,
            "diverged_episodes": training.diverged_episodes,
        },
        {"policy": training.policy.to_bytes()},
    )


def _infer(
    inputs: Inputs, blobs: Blobs, rng: np.random.Generator, progress: Progress
) -> StageResult:
    task = get_task(inputs["task"])
    problem = Problem(task, source_of(task.name, inputs["variant"]))
    settings, data = parse_settings(inputs["method"]), TransitionDataset.from_npz(blobs["data"])
    if isinstance(settings, OnlineSettings):
        method = settings.create()
        evidence = Evidence(Policy.from_bytes(blobs["policy"]), data)
        update = method.tell(problem, inputs["state"], evidence, rng, progress)
        values = asdict(update)
        values["distribution"] = method.ask(problem, update.state).to_json()
    else:
        assert isinstance(settings, OfflineSettings)
        estimate = settings.create().fit(problem, data, rng, progress)
        values = {
            "distribution": estimate.distribution.to_json(),
            "simulated_steps": estimate.simulated_steps,
            "diagnostics": estimate.diagnostics,
        }
    return StageResult(values)


def _target_rollout(
    inputs: Inputs, blobs: Blobs, rng: np.random.Generator, progress: Progress
) -> StageResult:
    task = get_task(inputs["task"])
    given = blobs.get("policy")
    act = random_actions(task, rng) if given is None else Policy.from_bytes(given).act
    data = simulate_rollout(task, inputs["variant"], act, inputs["transitions"], rng)
    return StageResult({"transitions": len(data)}, {"data": data.to_npz()})


def _target_return(
    inputs: Inputs, blobs: Blobs, rng: np.random.Generator, progress: Progress
) -> StageResult:
    """One full target episode, of which a method is told the return alone."""
    episode = simulate_evaluation(
        get_task(inputs["task"]), inputs["variant"], Policy.from_bytes(blobs["policy"]), 1, rng
    )
    return StageResult(
        {"return": float(episode.returns[0]), "transitions": int(episode.lengths[0])}
    )


def _propose(
    inputs: Inputs, blobs: Blobs, rng: np.random.Generator, progress: Progress
) -> StageResult:
    space = source_of(inputs["task"], inputs["variant"]).space
    boxes = [Uniform(space, box["low"], box["high"]) for box in inputs["distributions"]]
    proposal = propose(boxes, np.array(inputs["returns"]), rng)
    return StageResult(
        {
            "distribution": proposal.next.to_json(),
            "best": proposal.best,
            "simulated_steps": 0,
            "diagnostics": {
                "returns_seen": inputs["returns"],
                "posterior_means": proposal.means.tolist(),
                "reported": proposal.best,
            },
        }
    )


def _evaluate(
    inputs: Inputs, blobs: Blobs, rng: np.random.Generator, progress: Progress
) -> StageResult:
    episodes = simulate_evaluation(
        get_task(inputs["task"]),
        inputs["variant"],
        Policy.from_bytes(blobs["policy"]),
        inputs["episodes"],
        rng,
    )
    diverged = int(episodes.diverged.sum())
    return StageResult({"returns": episodes.returns.tolist(), "diverged_episodes": diverged})


def _criticise(
    inputs: Inputs, blobs: Blobs, rng: np.random.Generator, progress: Progress
) -> StageResult:
    with preparing():  # matplotlib and SciPy
        from adr_service.criticism.pipeline import criticise
        from adr_service.criticism.report import files_of

    task, variant = inputs["task"], inputs["variant"]
    nominal = Nominal.of_task(get_task(task), source_of(task, variant))
    data = Measurement.from_npz(blobs["data"])
    found = criticise(nominal, data, rng, progress, threads=1)  # a stage has one core
    found = replace(found, verdict=replace(found.verdict, seconds=None))  # equal results every time
    return StageResult({"verdict": found.verdict.to_json()}, files_of(found, f"{task}, {variant}"))


_FUNCTIONS: dict[str, Callable[[Inputs, Blobs, np.random.Generator, Progress], StageResult]] = {
    "train_policy": _train_policy,
    "infer": _infer,
    "target_rollout": _target_rollout,
    "target_return": _target_return,
    "propose": _propose,
    "evaluate": _evaluate,
    "criticise": _criticise,
}
