"""NumPy archives as logs."""

import numpy as np
import pytest

from adr_service.errors import InvalidInput
from adr_service.logs.npz_files import read_npz
from adr_service.npz import write_arrays


def test_arrays_with_rows_are_columns_and_others_are_not():
    arrays = {"t": np.arange(5), "q": np.arange(10.0).reshape(5, 2)}
    arrays |= {name: np.ones(3) for name in ("kp", "kd", "ki")}
    log = read_npz("log.npz", write_arrays(arrays))
    assert log.names == ["t", "q_0", "q_1"]
    assert log.unread["kp"] == "it is float64 of shape (3,), and the log has 5 rows"
    np.testing.assert_array_equal(log.streams[0].columns["q_1"], [1, 3, 5, 7, 9])


def test_columns_with_one_name_are_refused():
    arrays = {"q": np.zeros((5, 2)), "q_0": np.ones(5)}
    with pytest.raises(InvalidInput, match="has columns twice: q_0"):
        read_npz("log.npz", write_arrays(arrays))


def test_an_archive_with_a_pickle_is_refused(tmp_path):
    np.savez(tmp_path / "log.npz", t=np.array([{}, {}], dtype=object))
    with pytest.raises(InvalidInput, match="accepted are numbers and texts"):
        read_npz("log.npz", (tmp_path / "log.npz").read_bytes())


@pytest.mark.parametrize(
    "content", [b"", b"PK nothing", write_arrays({}), write_arrays({"a": 1.0})]
)
def test_what_has_no_rows_is_refused(content):
    with pytest.raises(
        InvalidInput, match=r"log.npz has no array with rows|log.npz: not a readable"
    ):
        read_npz("log.npz", content)
