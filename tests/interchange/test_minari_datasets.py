"""Recordings through Minari and back."""

from dataclasses import replace

import minari
import numpy as np
import pytest

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
    with pytest.raises(InvalidInput, match="refuses the name 'no version'"):
        to_minari(data, arm, "no version")


def test_what_does_not_fit_the_task_is_refused(arm, data):
    to_minari(data, arm, NAME)
    with pytest.raises(InvalidInput, match=r"hopper needs \(T \+ 1, 11 or more\)"):
        from_minari(NAME, get_task("hopper"))
    with pytest.raises(InvalidInput, match="4 columns; hopper measures 11"):
        to_minari(data, get_task("hopper"), "adr/hopper-v0")
    with pytest.raises(InvalidInput, match="Minari cannot read 'absent-v0'"):
        from_minari("absent-v0", arm)
