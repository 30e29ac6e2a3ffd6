"""Parquet tables and LeRobot data sets, written by the library that others write them with."""

import io
import json

import numpy as np
import pyarrow as pa
import pytest
from pyarrow import parquet

from adr_service.errors import InvalidInput
from adr_service.logs import base
from adr_service.logs.base import Clock
from adr_service.logs.catalogue import read_logs
from adr_service.logs.parquet_files import read_parquet


def content(table):
    buffer = io.BytesIO()
    parquet.write_table(table, buffer)
    return buffer.getvalue()


def test_lists_of_numbers_become_columns():
    states = pa.array([[1.0, 2.0], [3.0, 4.0]], pa.list_(pa.float32()))
    fixed = pa.array([[1.0, 2.0], [3.0, 4.0]], pa.list_(pa.float32(), 2))
    table = pa.table({"state": states, "fixed": fixed, "task": ["a", "b"], "ok": [True, False]})
    log = read_parquet("log.parquet", content(table))
    assert log.names == ["state_0", "state_1", "fixed_0", "fixed_1", "ok"]
    assert list(log.unread) == ["task"]
    np.testing.assert_array_equal(log.streams[0].columns["state_1"], [2, 4])


@pytest.mark.parametrize("size", [-1, 2])
def test_an_empty_cell_of_lists_is_no_reading_of_any_place(size):
    cells = [[1.0, 2.0], None, [3.0, 4.0]]
    table = pa.table({"state": pa.array(cells, pa.list_(pa.float32(), size))})
    log = read_parquet("log.parquet", content(table))
    np.testing.assert_array_equal(log.streams[0].columns["state_1"], [2, np.nan, 4])


@pytest.mark.parametrize(
    ("cells", "unread"),
    [([[], []], {}), ([None, None], {"state": "all its cells are empty"})],
    ids=str,
)
def test_lists_without_a_number_leave_the_other_columns(cells, unread):
    state = pa.array(cells, pa.list_(pa.float32()))
    log = read_parquet("log.parquet", content(pa.table({"t": [0.0, 1.0], "state": state})))
    assert log.names == ["t"]
    assert log.unread == unread


def test_lists_of_different_lengths_are_listed_as_unread():
    table = pa.table({"t": [0.0, 1.0], "state": [[1.0], [3.0, 4.0]]})
    log = read_parquet("log.parquet", content(table))
    assert log.names == ["t"]
    assert log.unread == {"state": "its lists are not all of one length"}


def test_numbers_that_are_written_as_texts_are_listed_with_the_first():
    column = pa.array([None, "3", "4"], pa.string())
    log = read_parquet("log.parquet", content(pa.table({"t": [0.0] * 3, "s": column})))
    reason = "it holds the text '3', first in row 2 below the header; accepted are numbers"
    assert log.unread == {"s": reason}


@pytest.mark.parametrize("cells", [[], [None, None]], ids=str)
def test_texts_without_a_cell_are_listed_as_unread(cells):
    column = pa.array(cells, pa.string())
    log = read_parquet("log.parquet", content(pa.table({"t": [0.0] * len(cells), "s": column})))
    assert log.unread == {"s": "it holds string"}


@pytest.mark.parametrize("damage", [b"", b"PAR1", b"PAR1" + b"\0" * 40 + b"PAR1"])
def test_what_is_no_parquet_is_refused(damage):
    with pytest.raises(InvalidInput, match=r"log\.parquet is no Parquet table that can be read"):
        read_parquet("log.parquet", damage)


def test_a_damaged_table_is_refused():
    whole = bytearray(content(pa.table({"t": np.arange(1000.0)})))
    whole[100:200] = bytes(100)
    with pytest.raises(InvalidInput, match="is no Parquet table that can be read"):
        read_parquet("log.parquet", bytes(whole))


@pytest.fixture
def lerobot(tmp_path):
    """A data set as LeRobot v3 lays it out."""
    folder = tmp_path / "swing"
    (folder / "data" / "chunk-000").mkdir(parents=True)
    (folder / "meta").mkdir()
    motors = ["shoulder.pos", "elbow.pos"]
    features = {
        "observation.state": {"dtype": "float32", "shape": [2], "names": motors},
        "action": {"dtype": "float32", "shape": [2], "names": {"motors": motors}},
        "timestamp": {"dtype": "float32", "shape": [1], "names": None},
    }
    (folder / "meta" / "info.json").write_text(json.dumps({"features": features, "fps": 30}))
    table = pa.table(
        {
            "observation.state": [[1.0, 2.0], [3.0, 4.0], [5.0, 6.0]],
            "action": [[1.0, 2.0], [3.0, 4.0], [5.0, 6.0]],
            "timestamp": [0.0, 1 / 30, 2 / 30],
            "episode_index": [0, 0, 0],
        }
    )
    parquet.write_table(table, folder / "data" / "chunk-000" / "file-000.parquet")
    return folder


def test_a_lerobot_data_set_names_its_columns_by_joint(lerobot):
    (log,) = read_logs(lerobot)
    assert "observation.state.elbow.pos" in log.names
    signal = log.signal("action.elbow.pos", Clock("timestamp", "s"))
    np.testing.assert_array_equal(signal.value, [2, 4, 6])


@pytest.mark.parametrize(
    ("names", "column"),
    [
        ([["shoulder", "elbow"]], "observation.state.elbow"),
        ({"motors": [["shoulder", "elbow"]]}, "observation.state.elbow"),
        ({"elbow": 1, "shoulder": 0}, "observation.state.elbow"),
        ({"left": ["a"], "right": ["b"]}, "observation.state_1"),
        (["shoulder"], "observation.state_1"),  # not as many as places: all are numbered
        (["x", "y", "z"], "observation.state_1"),
        (None, "observation.state_1"),
    ],
)
def test_names_of_lerobots_places_may_be_nested_and_are_as_many_as_these(lerobot, names, column):
    file = lerobot / "meta" / "info.json"
    about = json.loads(file.read_text())
    about["features"]["observation.state"]["names"] = names
    file.write_text(json.dumps(about))
    (log,) = read_logs(lerobot)
    states = [name for name in log.names if name.startswith("observation.state")]
    assert len(states) == 2
    assert states[1] == column


def test_a_lerobot_data_set_that_names_two_places_alike_is_refused(lerobot):
    about = lerobot / "meta" / "info.json"
    about.write_text(about.read_text().replace("elbow.pos", "shoulder.pos"))
    with pytest.raises(InvalidInput, match=r"info.json names observation.state.shoulder.pos, .*"):
        read_logs(lerobot)


def test_a_lerobot_data_set_without_its_description_is_refused(lerobot):
    (lerobot / "meta" / "info.json").write_text('{"features": 3}')
    with pytest.raises(InvalidInput, match="does not describe a LeRobot data set"):
        read_logs(lerobot)


def test_another_folder_is_refused(tmp_path):
    with pytest.raises(
        InvalidInput, match=r"is neither a LeRobot data set .* name the files in it"
    ):
        read_logs(tmp_path)


def test_a_table_that_unpacks_to_too_much_is_refused(monkeypatch):
    monkeypatch.setattr(base, "MOST_BYTES", 10_000)
    with pytest.raises(InvalidInput, match=r"unpacked, has .* bytes; accepted are 10,000"):
        read_parquet("log.parquet", content(pa.table({"t": np.arange(10_000.0)})))
