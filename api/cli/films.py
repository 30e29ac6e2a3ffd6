"""Films of policies and recordings in files."""

from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from adr_service.arrays import Vector
from adr_service.errors import InvalidInput
from adr_service.simulation.batch import control_period
from adr_service.simulation.gym_env import RandomizedEnv
from adr_service.simulation.rendering import of_policy, of_recording, save, stride_of
from adr_service.tasks.base import Task
from adr_service.tasks.catalogue import get_task, source_of
from adr_service.training.policy import Policy
from adr_service.transitions import TransitionDataset


@dataclass(frozen=True)
class Scene:
    """A task's variant to film, with some parameters set and all others at their true values."""

    task: str
    variant: str
    dynamics: dict[str, Any]
    steps: int | None  # at most; None: an episode's length
    seed: int


def film_policy(scene: Scene, file: Path, out: Path) -> int:
    """Write a film of one episode; return the number of pictures."""
    task, policy = get_task(scene.task), Policy.from_bytes(_read(file))
    _check_policy(policy, task, file)
    period_s = control_period(task)
    every = stride_of(out, period_s)
    env = RandomizedEnv(scene.task, scene.variant, render_mode="rgb_array")
    options, steps = {"dynamics": scene.dynamics}, scene.steps or task.horizon
    pictures = of_policy(env, policy.act, steps, every=every, seed=scene.seed, options=options)
    with closing(env):
        return save(pictures, out, every * period_s)


def _check_policy(policy: Policy, task: Task, file: Path) -> None:
    given = (policy.layers[0][0].shape[1], len(policy.action_low))
    if given != (len(task.columns), len(task.action_low)):
        raise InvalidInput(
            f"{file} makes {given[1]} actions of {given[0]} observations; {task.name} takes "
            f"{len(task.action_low)} and shows {len(task.columns)}"
        )


def film_recording(scene: Scene, file: Path, episode: int, out: Path) -> int:
    """Write a film of a recorded episode beside its replay; return the number of pictures."""
    task, data = get_task(scene.task), TransitionDataset.from_npz(_read(file))
    episodes = data.split()
    if not 0 <= episode < len(episodes):
        raise InvalidInput(f"{file} has episodes 0 to {len(episodes) - 1}; given {episode}")
    dynamics, source = _dynamics(scene), source_of(task.name, scene.variant)
    period_s = control_period(task)
    every = stride_of(out, period_s)
    shown = episodes[episode].first(scene.steps or task.horizon)
    return save(of_recording(task, source, dynamics, shown, every), out, every * period_s)


def _dynamics(scene: Scene) -> Vector:
    """All parameters of the scene, in order."""
    with closing(RandomizedEnv(scene.task, scene.variant)) as env:
        _, info = env.reset(options={"dynamics": scene.dynamics})
    return np.array(list(info["dynamics"].values()))


def _read(file: Path) -> bytes:
    try:
        return file.read_bytes()
    except OSError as error:
        raise InvalidInput(f"{file} cannot be read: {error.strerror}") from error
