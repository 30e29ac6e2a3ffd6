"""Stages whose results are written here instead of computed, in the form in which they are stored.

They depend on a stage's digest alone, so that the digests of everything that a run asks for can be
compared over versions of the code.
"""

import numpy as np

from adr_service.randomness import stream
from adr_service.simulation.batch import control_period
from adr_service.stages.base import StageResult, events_of
from adr_service.tasks.catalogue import get_task, source_of
from adr_service.transitions import TransitionDataset


class CannedStages:
    """Answers at once, and keeps the kind, digest and result of every stage that was asked for."""

    run_id = "run_canned"

    def __init__(self):
        self.asked, self.results = [], {}

    def all(self, stages):
        results = []
        for stage in stages:
            self.asked.append((stage.kind, stage.digest))
            self.results[stage.digest] = self.answer(stage)
            result = stage.read(self.results[stage.digest])
            yield from events_of(stage, result)
            results.append(result)
        return results

    def run(self, stage):
        return (yield from self.all([stage]))[0]

    def answer(self, stage):
        return canned(stage)


def canned(stage):
    return _RESULTS[stage.kind](stage.inputs, stage.digest)


def _trained(inputs, digest):
    points = [{"steps": 300, "mean_return": 1.5, "standard_error": 0.25}]
    points.append({"steps": 600, "mean_return": 2.5, "standard_error": 0.5})
    values = {
        "steps": 600,
        "source_return": 2.5,
        "reached_threshold": False,
        "curve": points,
        "adjusted_draws": 3,
        "diverged_episodes": 1,
    }
    if "curriculum" in inputs:
        values["phases"] = [{"steps": 0, "distribution": inputs["distribution"]}]
    return StageResult(values, {"policy": f"policy {digest}".encode()})


def _inferred(inputs, digest):
    space = source_of(inputs["task"], inputs["variant"]).space
    location = 4 * stream("canned", digest).random(len(space))
    belief = {
        "kind": "gaussian",
        "location": np.round(location, 3).tolist(),
        "covariance": (0.25 * np.eye(len(space))).tolist(),
    }
    found = {"distribution": belief, "simulated_steps": 1000}
    if "state" in inputs:
        return StageResult({**found, "state": belief, "diagnostics": {"updates": []}})
    error = round(float(location[0]), 3)
    epsilon = inputs["method"].get("epsilon", 0.0)
    return StageResult({**found, "diagnostics": {"mean_squared_error": error, "epsilon": epsilon}})


def _proposed(inputs, digest):
    space, rng = source_of(inputs["task"], inputs["variant"]).space, stream("canned", digest)
    low = np.round(space.low + 0.5 * rng.random(len(space)) * (space.high - space.low), 3)
    box = {"kind": "uniform", "low": low.tolist(), "high": space.high.tolist()}
    best = int(np.argmax(inputs["returns"]))
    return StageResult(
        {"distribution": box, "best": best, "simulated_steps": 0, "diagnostics": {"reported": best}}
    )


def _recorded(inputs, digest):
    task, rng = get_task(inputs["task"]), stream("canned", digest)
    n = inputs["transitions"]
    rows = np.round(rng.random((n + 1, task.measured)), 3)
    return TransitionDataset(
        observations=rows[:-1],
        actions=np.zeros((n, len(task.action_low))),
        next_observations=rows[1:],
        episodes=np.zeros(n, dtype=np.int64),
        dt=control_period(task),
        columns=task.columns[: task.measured],
        origin="canned",
    ).to_npz()


def _rollout(inputs, digest):
    data = _recorded(inputs, digest)
    return StageResult({"transitions": inputs["transitions"]}, {"data": data})


def _smoothed(inputs, digest):
    values = {"parameters": [1.5], "sensor_std": [0.01, None], "simulated_steps": 3000}
    return StageResult(values, {"data": _recorded({**inputs, "transitions": 30}, digest)})


def _robots_episode(inputs, digest):
    earned = round(float(stream("canned", digest).random()), 3)
    values = {"transitions": inputs["transitions"], "return": earned}
    return StageResult(values, {"data": _recorded(inputs, digest)})


def _earned(inputs, digest):
    earned = round(float(stream("canned", digest).random()), 3)
    return StageResult({"return": earned, "transitions": 200})


def _evaluated(inputs, digest):
    returns = np.round(stream("canned", digest).random(inputs["episodes"]), 3).tolist()
    return StageResult({"returns": returns, "diverged_episodes": 0})


def _criticised(inputs, digest):
    return StageResult(
        {"verdict": {"verdict": "none"}},
        {"verdict.json": digest.encode(), "report.html": b"report"},
    )


_RESULTS = {
    "train_policy": _trained,
    "infer": _inferred,
    "propose": _proposed,
    "target_rollout": _rollout,
    "target_return": _earned,
    "target_episode": _robots_episode,
    "evaluate": _evaluated,
    "criticise": _criticised,
    "smooth_states": _smoothed,
}
