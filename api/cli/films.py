"""Films of policies and recordings in files."""

import json
from collections.abc import Iterable, Sequence
from contextlib import ExitStack, closing
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from adr_service.arrays import Vector
from adr_service.errors import InvalidInput
from adr_service.simulation.batch import control_period
from adr_service.simulation.gym_env import RandomizedEnv
from adr_service.simulation.rendering import (
    Picture,
    beside,
    of_policy,
    of_recording,
    save,
    stride_of,
)
from adr_service.tasks.base import Task
from adr_service.tasks.catalogue import first_like, get_task, source_of, target_like, variant_of
from adr_service.training.policy import Policy
from adr_service.transitions import TransitionDataset
from api.cli.files import naming, read


@dataclass(frozen=True)
class Scene:
    """A task's variant to film, with some parameters set and all others at their true values."""

    task: str
    variant: str
    dynamics: dict[str, Any]
    steps: int | None  # at most; None: an episode's length
    seed: int
    most_fps: float | None = None  # of an .mp4; None: a picture for every step


def film_policy(scene: Scene, file: Path, out: Path) -> int:
    """Write a film of one episode; return the number of pictures."""
    return _film(file, out, [scene])


def film_beside_target(scene: Scene, file: Path, distribution: Path, out: Path) -> int:
    """Write a film of an episode in the source beside one on the target.

    The source has the mean of a run's training distribution, a file as `adr results --distribution`
    writes it. Both episodes begin alike.
    """
    mean, target = _mean(distribution, scene), target_like(scene.task, scene.variant)
    known = variant_of(scene.task, scene.variant).source.space.names
    # the oracle is trained on the target's own parameters
    source = first_like(scene.task, scene.variant) if mean.keys() <= set(known) else target
    left = replace(scene, variant=source, dynamics=mean)
    return _film(file, out, [left, replace(scene, variant=target)])


def _mean(distribution: Path, scene: Scene) -> dict[str, Any]:
    """Means of a distribution's parameters, by name; of the first, if there are several."""
    try:
        found = json.loads(read(distribution))
        task, variant = str(found["task"]), str(found["variant"])
        mean = {each["name"]: each["mean"][0] for each in found["parameters"]}
        extension = found.get("extension", [])
    except (ValueError, LookupError, TypeError) as error:
        raise InvalidInput(f"{distribution} is no file of adr results --distribution") from error
    # the oracle trains on the target's parameters; its file names the first variant that has them
    both = (scene.variant, target_like(scene.task, scene.variant))
    fitting = {first_like(scene.task, each) for each in both}
    if task != scene.task or first_like(task, variant) not in fitting:
        raise InvalidInput(
            f"{distribution} is of {task} {variant}, and the film of {scene.task} {scene.variant}: "
            f"give --task {task} --variant {variant}"
        )
    if extension:
        raise InvalidInput(
            f"films show a task's own simulator; {distribution} has effects beyond it: {extension}"
        )
    return mean


def _film(file: Path, out: Path, scenes: Sequence[Scene]) -> int:
    """Write a film of a policy's episode in each scene, side by side."""
    task, content = get_task(scenes[0].task), read(file)
    with naming(file):
        policy = Policy.from_bytes(content)
    _check_policy(policy, task, file)
    period_s = control_period(task)
    every = stride_of(out, period_s, scenes[0].most_fps)
    with ExitStack() as opened:
        films: list[Iterable[Picture]] = []
        for scene in scenes:
            env = RandomizedEnv(scene.task, scene.variant, render_mode="rgb_array")
            opened.enter_context(closing(env))
            steps, options = scene.steps or task.horizon, {"dynamics": scene.dynamics}
            films.append(
                of_policy(env, policy.act, steps, every=every, seed=scene.seed, options=options)
            )
        return save(beside(*films) if len(films) > 1 else films[0], out, every * period_s)


def _check_policy(policy: Policy, task: Task, file: Path) -> None:
    given = (policy.layers[0][0].shape[1], len(policy.action_low))
    if given != (len(task.columns), len(task.action_low)):
        raise InvalidInput(
            f"{file} makes {given[1]} actions of {given[0]} observations; {task.name} takes "
            f"{len(task.action_low)} and shows {len(task.columns)}"
        )


def film_recording(scene: Scene, file: Path, episode: int, out: Path) -> int:
    """Write a film of a recorded episode beside its replay; return the number of pictures."""
    task, content = get_task(scene.task), read(file)
    with naming(file):
        data = TransitionDataset.from_npz(content)
    episodes = data.split()
    if not 0 <= episode < len(episodes):
        raise InvalidInput(f"{file} has episodes 0 to {len(episodes) - 1}; given {episode}")
    dynamics, source = _dynamics(scene), source_of(task.name, scene.variant)
    period_s = control_period(task)
    every = stride_of(out, period_s, scene.most_fps)
    whole = episodes[episode]
    shown = whole if scene.steps is None else whole.first(scene.steps)
    return save(of_recording(task, source, dynamics, shown, every), out, every * period_s)


def _dynamics(scene: Scene) -> Vector:
    """All parameters of the scene, in order."""
    with closing(RandomizedEnv(scene.task, scene.variant)) as env:
        _, info = env.reset(options={"dynamics": scene.dynamics})
    return np.array(list(info["dynamics"].values()))
