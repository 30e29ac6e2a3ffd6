"""Uploaded recordings."""

from dataclasses import replace

import pytest

from adr_service.events import RunFailed
from adr_service.specs import RunSpec
from adr_service.transitions import TransitionDataset
from db import datasets, events, runs
from db.errors import NotFound, NotPossible
from tests.db.rows import a_recording, count


def test_equal_bytes_are_one_dataset(database):
    content = a_recording()
    data = TransitionDataset.from_npz(content)
    record, is_new = datasets.store_dataset(database, content, data)
    assert is_new
    assert datasets.store_dataset(database, content, data) == (record, False)
    assert datasets.load_dataset(database, record.id) == (record, content)
    assert (record.transitions, record.episodes, record.actions) == (4, 2, 2)
    assert datasets.list_datasets(database) == [record]


def test_data_that_say_no_origin_have_the_name_of_their_file(database):
    recording = TransitionDataset.from_npz(a_recording())
    silent = replace(recording, origin="unknown").to_npz()
    for content, origin in ((recording.to_npz(), recording.origin), (silent, "arm.npz")):
        data = TransitionDataset.from_npz(content)
        record, _ = datasets.store_dataset(database, content, data, "arm.npz")
        assert record.origin == origin
        assert datasets.origins_of(database, [record.id]) == {record.id: origin}


def test_a_dataset_that_a_run_learns_from_cannot_be_deleted(database):
    content = a_recording()
    record, _ = datasets.store_dataset(database, content, TransitionDataset.from_npz(content))
    target = {"kind": "recorded", "dataset": record.id}
    spec = {"task": "arm", "method": "droid", "preset": "smoke", "target": target}
    run = runs.create_run(database, RunSpec.model_validate(spec))
    with pytest.raises(NotPossible, match=f"{run.id} learns from {record.id}"):
        datasets.delete_dataset(database, record.id)
    events.append_event(database, run.id, RunFailed(submission=1, code="x", message="y"))
    runs.delete_run(database, run.id)
    assert datasets.load_dataset(database, record.id)[0] == record  # its bytes are still there
    datasets.delete_dataset(database, record.id)
    assert count(database, "artifacts") == 0
    with pytest.raises(NotFound, match="dataset"):
        runs.create_run(database, RunSpec.model_validate(spec))
