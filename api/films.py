"""Films from files: what `adr render` does."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from adr_service.errors import InvalidInput
from adr_service.simulation.gym_env import RandomizedEnv
from adr_service.simulation.rendering import check_name, of_policy, of_recording, save
from adr_service.tasks.catalogue import get_task, source_of
from adr_service.training.policy import Policy
from adr_service.transitions import TransitionDataset


@dataclass(frozen=True)
class Scene:
    """What is filmed: a task's variant, with some parameters set and all others true."""

    task: str
    variant: str
    dynamics: dict[str, Any]
    steps: int  # at most
    seed: int


def film_policy(scene: Scene, file: Path, out: Path) -> int:
    """Write a film of one episode; returns the number of pictures."""
    check_name(out)
    task, policy = get_task(scene.task), Policy.from_bytes(_read(file))
    width = policy.layers[0][0].shape[1]
    if width != len(task.columns):
        raise InvalidInput(
            f"{file} acts on {width} observations; {task.name} has {len(task.columns)}"
        )
    env = RandomizedEnv(scene.task, scene.variant, render_mode="rgb_array")
    options = {"dynamics": scene.dynamics}
    pictures = of_policy(env, policy.act, scene.steps, scene.seed, options)
    env.close()
    save(pictures, out, task)
    return len(pictures)


def film_recording(scene: Scene, file: Path, episode: int, out: Path) -> int:
    """Write a film of a recorded episode beside its replay; returns the number of pictures."""
    check_name(out)
    task, data = get_task(scene.task), TransitionDataset.from_npz(_read(file))
    given = (data.observations.shape[1], data.actions.shape[1])
    if given != (task.measured, len(task.action_low)):
        raise InvalidInput(
            f"{file} has {given[0]} observations and {given[1]} actions; {task.name} measures "
            f"{task.measured} and takes {len(task.action_low)}"
        )
    episodes = data.split()
    if not 0 <= episode < len(episodes):
        raise InvalidInput(f"{file} has episodes 0 to {len(episodes) - 1}; given {episode}")
    env = RandomizedEnv(scene.task, scene.variant)
    env.reset(seed=scene.seed, options={"dynamics": scene.dynamics})
    dynamics = np.array(list(env.dynamics.values()))
    source = source_of(scene.task, scene.variant)
    pictures = of_recording(task, source, dynamics, episodes[episode].first(scene.steps))
    save(pictures, out, task)
    return len(pictures)


def _read(file: Path) -> bytes:
    try:
        return file.read_bytes()
    except OSError as error:
        raise InvalidInput(f"{file} cannot be read: {error.strerror}") from error
