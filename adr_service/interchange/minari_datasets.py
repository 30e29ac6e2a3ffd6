"""Recordings as Minari's data sets, and back.

    to_minari(data, get_task("hopper"), "adr/hopper-v0")    # in the folder MINARI_DATASETS_PATH
    data = from_minari("adr/hopper-v0", get_task("hopper"))

A recording has no rewards, and a data set of Minari must have some: they are NaN. What Minari has
no place for is in the metadata: `adr_columns`, with units, `adr_dt` [s] and `adr_origin`.
"""

import warnings
from typing import Any

import numpy as np

from adr_service.errors import InvalidInput
from adr_service.interchange.libraries import library
from adr_service.simulation.batch import control_period
from adr_service.simulation.replay import check_recorded
from adr_service.tasks.base import Task
from adr_service.transitions import TransitionDataset

_MOST_NUMBERS = 2**27  # 1 GB


def to_minari(data: TransitionDataset, task: Task, name: str) -> Any:
    """Store a recording of a task under a name of Minari, and return the `MinariDataset`.

    Raises InvalidInput for a name that Minari refuses or has, for data that are not of the task's
    robot, and for rows that do not follow one another.
    """
    minari, spaces = library("minari"), library("gymnasium").spaces
    _check_name(name)
    check_recorded(task, data)
    data.check_chained("a data set of Minari")
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", UserWarning)  # authors and code are for publishing
            stored = minari.create_dataset_from_buffers(
                name,
                [_buffer(episode) for episode in data.split()],
                observation_space=spaces.Box(-np.inf, np.inf, (task.measured,), np.float64),
                action_space=spaces.Box(task.action_low, task.action_high, dtype=np.float64),
                algorithm_name="unknown",
                description=data.origin,
                data_format="arrow",
            )
    except ValueError as error:
        raise InvalidInput(f"Minari refuses {name!r}: {error}") from error
    stored.storage.update_metadata(
        {"adr_columns": list(data.columns), "adr_dt": data.dt, "adr_origin": data.origin}
    )
    return stored


def _check_name(name: str) -> None:
    """Raise InvalidInput for a name that Minari would refuse after it had made a folder."""
    from minari.dataset.minari_dataset import parse_dataset_id

    try:
        parse_dataset_id(name)
    except (TypeError, ValueError) as error:  # the first for a name without a version
        raise InvalidInput(
            f"Minari refuses the name {name!r}; accepted are names as adr/hopper-v0, with a version"
        ) from error


def _buffer(episode: TransitionDataset) -> Any:
    from minari.data_collector.episode_buffer import EpisodeBuffer

    rows = len(episode)
    return EpisodeBuffer(
        observations=[*episode.observations, episode.next_observations[-1]],
        actions=list(episode.actions),
        rewards=[np.nan] * rows,
        terminations=[False] * rows,
        truncations=[False] * (rows - 1) + [True],
    )


def from_minari(name: str, task: Task) -> TransitionDataset:
    """The transitions of a local data set of Minari, as recordings of a task.

    Observations have the task's measured columns first, and rows its control period, unless the
    metadata say otherwise. Raises InvalidInput for an absent data set, and for one that does not
    fit.
    """
    minari = library("minari")
    try:
        _check_spaces(name)
        stored = minari.load_dataset(name)
        _check_rows(name, stored)
        episodes = _episodes(name, stored)
        metadata: dict[str, Any] = stored.storage.metadata
        dt = float(metadata.get("adr_dt", control_period(task)))
        columns = tuple(map(str, metadata.get("adr_columns", task.columns[: task.measured])))
        given = "adr_dt" in metadata
        taken = "" if given else f" (time step not given: {dt:g} s, as {task.name} has)"
        origin = str(metadata.get("adr_origin", f"Minari: {name}{taken}"))
    except InvalidInput:
        raise
    except Exception as error:  # whatever Minari and its storages raise
        raise InvalidInput(f"Minari cannot read {name!r}: {error}") from error
    for episode in episodes:
        _check(name, episode, task)
    seen = [episode.observations[:, : task.measured] for episode in episodes]
    lengths = [len(episode.actions) for episode in episodes]
    return TransitionDataset(
        observations=np.concatenate([each[:-1] for each in seen]),
        actions=np.concatenate([episode.actions for episode in episodes]),
        next_observations=np.concatenate([each[1:] for each in seen]),
        episodes=np.repeat(np.arange(len(episodes)), lengths),
        dt=dt,
        columns=columns,
        origin=origin,
    )


def _check_spaces(name: str) -> None:
    """Raise InvalidInput unless the metadata have spaces.

    Without them Minari makes the environment that the metadata name, and so runs any code.
    """
    from minari.dataset.minari_storage import MinariStorage
    from minari.storage import get_dataset_path

    metadata = MinariStorage.read_raw_metadata(get_dataset_path(name) / "data")
    if missing := {"observation_space", "action_space"} - set(metadata):
        raise InvalidInput(f"{name!r} has no {' and no '.join(sorted(missing))}")


def _check_rows(name: str, stored: Any) -> None:
    """Raise InvalidInput unless there are steps, which are rows of numbers."""
    rows, spaces = int(stored.total_steps), (stored.observation_space, stored.action_space)
    widths = [shape[0] for space in spaces if len(shape := space.shape or ()) == 1]
    if not rows or len(widths) != len(spaces):
        raise InvalidInput(
            f"{name!r} has {rows} steps, with observations {spaces[0]} and actions {spaces[1]}; "
            "needed are some steps, and a row of numbers for each"
        )


def _episodes(name: str, stored: Any) -> list[Any]:
    """All episodes. Raises InvalidInput for too many numbers, however many the metadata claim."""
    episodes, numbers = list[Any](), 0
    for episode in stored.iterate_episodes():
        numbers += np.size(episode.observations) + np.size(episode.actions)
        if numbers > _MOST_NUMBERS:
            raise InvalidInput(f"{name!r} has too many numbers; accepted are {_MOST_NUMBERS:,}")
        episodes.append(episode)
    return episodes


def _check(name: str, episode: Any, task: Task) -> None:
    """Raise InvalidInput unless an episode has a task's observations and actions."""
    shapes = [np.shape(each) for each in (episode.observations, episode.actions)]
    width = len(task.action_low)
    (states, seen), (steps, sent) = [shape if len(shape) == 2 else (0, 0) for shape in shapes]
    if seen < task.measured or sent != width or states != steps + 1:
        raise InvalidInput(
            f"episode {episode.id} of {name!r} has observations {shapes[0]} and actions "
            f"{shapes[1]}; {task.name} needs (T + 1, {task.measured} or more) and (T, {width})"
        )
