"""Upload recordings from the command line."""

import json

import numpy as np
import pytest

from adr_service.errors import InvalidInput
from adr_service.transitions import TransitionDataset
from api.cli.data import _datasets_table, read_recording
from api.cli.terminal import console
from tests.recordings import recording


@pytest.fixture(scope="module")
def data():
    return recording("arm", 40)


def save_npy(prefix, data):
    """Write DROPO's four files."""
    arrays = (("observations", data.observations), ("actions", data.actions))
    arrays += (("nextobservations", data.next_observations), ("terminals", np.zeros(len(data))))
    for name, values in arrays:
        np.save(f"{prefix}_{name}.npy", values)


def test_an_npz_is_read_as_it_is(tmp_path, data):
    file = tmp_path / "arm.npz"
    file.write_bytes(data.to_npz())
    assert read_recording(file, "arm") == data.to_npz()


def test_dropos_files_become_one_recording_with_the_tasks_period_and_columns(tmp_path, data):
    save_npy(tmp_path / "dropo", data)
    combined = TransitionDataset.from_npz(read_recording(tmp_path / "dropo", "arm"))
    np.testing.assert_array_equal(combined.observations, data.observations)
    assert combined.columns == data.columns
    assert combined.dt == pytest.approx(data.dt)
    save_npy(tmp_path / "dropo_v1.0", data)
    dotted = TransitionDataset.from_npz(read_recording(tmp_path / "dropo_v1.0", "arm"))
    np.testing.assert_array_equal(dotted.observations, data.observations)


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("text.txt", "an .npz, or a prefix of .npy files; given .*text.txt"),
        ("none.npz", "none.npz cannot be read: No such file"),
        ("none", r"none_\*.npy cannot be read"),
    ],
)
def test_an_unreadable_file_is_refused(tmp_path, name, message):
    with pytest.raises(InvalidInput, match=message):
        read_recording(tmp_path / name, "arm")


@pytest.mark.ray
def test_a_recording_is_uploaded_and_learned_from(adr, tmp_path, data):
    (tmp_path / "arm.npz").write_bytes(data.to_npz())
    code, shown = adr("upload", "arm.npz", "--task", "arm")
    assert code == 0
    dataset = shown.strip()
    assert dataset in adr("datasets")[1]
    options = ["--task", "arm", "--method", "droid", "--preset", "smoke", "--dataset", dataset]
    code, shown = adr("submit", *options, "--set", "target.episodes=1", "--watch")
    assert code == 0
    assert "upper_mass" in shown
    assert "mean nothing" in shown  # the smoke preset
    id = shown.split()[0]
    assert adr("results", id, "--distribution", "distribution.json")[0] == 0
    distribution = json.loads((tmp_path / "distribution.json").read_text())
    assert [p["unit"] for p in distribution["parameters"]][:2] == ["kg", "kg"]
    save_npy(tmp_path / "dropo", data)
    assert adr("upload", "dropo", "--task", "arm")[1].startswith("data_")


def test_the_origin_of_a_recording_is_shown_as_it_is():
    """It may look like Rich's markup, which was left out or ended the command."""
    data = {"id": "data_1", "transitions": 2, "episodes": 1, "dt": 0.02}
    table = _datasets_table([{**data, "origin": name} for name in ("log[a].npz", "log[/run].npz")])
    with console.capture() as captured:
        console.print(table)
    assert "log[a].npz" in captured.get()
    assert "log[/run].npz" in captured.get()
