"""Recordings through Minari and back."""

import json
from dataclasses import replace

import minari
import numpy as np
import pytest
from gymnasium.envs.registration import EnvSpec
from gymnasium.spaces import Box
from minari.data_collector.episode_buffer import EpisodeBuffer

from adr_service.errors import InvalidInput
from adr_service.interchange.minari_datasets import from_minari, to_minari
from adr_service.tasks.catalogue import get_task
from adr_service.transitions import TransitionDataset
from tests.recordings import recording

NAME = "adr/arm-v0"


@pytest.fixture(autouse=True)
def own_folder(tmp_path, monkeypatch):
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(tmp_path))


@pytest.fixture
def arm():
    return get_task("arm")


@pytest.fixture
def data():
    parts = [recording("arm", steps) for steps in (30, 20)]
    numbered = (replace(part, episodes=part.episodes + i) for i, part in enumerate(parts))
    return TransitionDataset.concatenate(list(numbered))


def test_a_recording_comes_back_as_it_was(arm, data):
    to_minari(data, arm, NAME)
    assert from_minari(NAME, arm).to_npz() == data.to_npz()


def test_minari_finds_episodes_with_their_spaces(arm, data):
    to_minari(data, arm, NAME)
    found = minari.load_dataset(NAME)
    assert found.total_episodes == data.episode_count
    assert found.total_steps == len(data)
    first = next(found.iterate_episodes())
    assert found.observation_space.contains(first.observations[0])
    assert np.isnan(first.rewards).all()


def test_a_name_that_is_taken_or_wrong_is_refused(arm, data):
    to_minari(data, arm, NAME)
    with pytest.raises(InvalidInput, match="arm-v0"):
        to_minari(data, arm, NAME)


@pytest.mark.parametrize("name", ["no version", "arm", "arm-x", "adr/arm-v1.2"])
def test_a_name_that_minari_does_not_know_is_refused_and_leaves_no_folder(
    arm, data, tmp_path, name
):
    with pytest.raises(InvalidInput, match=f"refuses the name '{name}'; accepted are names as"):
        to_minari(data, arm, name)
    assert list(tmp_path.iterdir()) == []


def test_what_does_not_fit_the_task_is_refused(arm, data):
    to_minari(data, arm, NAME)
    with pytest.raises(InvalidInput, match=r"hopper needs \(T \+ 1, 11 or more\)"):
        from_minari(NAME, get_task("hopper"))
    with pytest.raises(InvalidInput, match="hopper measures 11"):
        to_minari(data, get_task("hopper"), "adr/hopper-v0")
    with pytest.raises(InvalidInput, match="Minari cannot read 'absent-v0'"):
        from_minari("absent-v0", arm)
    noisy = replace(data, next_observations=data.next_observations + 1e-3)
    with pytest.raises(InvalidInput, match="a data set of Minari needs each next observation"):
        to_minari(noisy, arm, "adr/noisy-v0")


@pytest.mark.parametrize(
    ("field", "value"), [("adr_dt", "hello"), ("adr_dt", None), ("adr_columns", 5)]
)
def test_metadata_that_make_no_sense_are_refused(arm, data, tmp_path, field, value):
    to_minari(data, arm, NAME)
    change(tmp_path, **{field: value})
    with pytest.raises(InvalidInput, match="Minari cannot read"):
        from_minari(NAME, arm)


@pytest.mark.parametrize("space", ["observation_space", "action_space"])
def test_a_hostile_data_set_runs_no_code(arm, data, tmp_path, space):
    """Minari makes the environment that a file names where the file has no spaces."""
    to_minari(data, arm, NAME)
    ran = tmp_path / "ran"
    hostile = EnvSpec("hostile-v0", "subprocess:run", kwargs={"args": ["touch", str(ran)]})
    change(tmp_path, env_spec=hostile.to_json(), **{space: None})
    with pytest.raises(InvalidInput, match=f"has no {space}"):
        from_minari(NAME, arm)
    assert not ran.exists()


def test_a_data_set_with_more_numbers_than_its_metadata_claim_is_refused(
    arm, data, tmp_path, monkeypatch
):
    monkeypatch.setattr("adr_service.interchange.minari_datasets._MOST_NUMBERS", data.actions.size)
    to_minari(data, arm, NAME)
    change(tmp_path, total_steps=1)
    with pytest.raises(InvalidInput, match=f"too many numbers; accepted are {data.actions.size}"):
        from_minari(NAME, arm)


@pytest.mark.filterwarnings("ignore::UserWarning")  # on authors and code, for publishing
def test_a_data_set_in_minaris_own_format_is_read(arm, data):
    """Others' data sets are HDF5, have no word of ours, and more columns than are measured."""
    wide = Box(-np.inf, np.inf, (6,), np.float64)
    buffer = EpisodeBuffer(
        observations=[np.arange(6.0) + i for i in range(4)],
        actions=[np.zeros(2)] * 3,
        rewards=[1.0] * 3,
        terminations=[False] * 3,
        truncations=[False, False, True],
    )
    spaces = {"observation_space": wide, "action_space": Box(-1, 1, (2,), np.float64)}
    minari.create_dataset_from_buffers("theirs-v0", [buffer], **spaces)
    found = from_minari("theirs-v0", arm)
    assert found.observations.tolist() == [[i, i + 1, i + 2, i + 3] for i in range(3)]
    assert (found.dt, found.columns) == (0.02, arm.columns)
    assert found.origin == "Minari: theirs-v0 (time step not given: 0.02 s, as arm has)"


def change(folder, **metadata):
    """Change the metadata of a stored data set; None leaves a field out."""
    file = folder / NAME / "data/metadata.json"
    known = {**json.loads(file.read_text()), **metadata}
    needed = {"observation_space", "action_space"}
    kept = {k: v for k, v in known.items() if v is not None or k not in needed}
    file.write_text(json.dumps(kept))
