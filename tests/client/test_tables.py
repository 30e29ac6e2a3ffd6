"""Tables as pandas frames."""

import pytest

from adr_service.client import Results, Rows
from adr_service.errors import UnknownName

RUNS = [{"id": "run_1", "spec": {"task": "arm", "method": {"name": "simopt"}}, "states": [1]}]


def test_fields_of_nested_objects_are_columns():
    frame = Rows(RUNS).to_pandas()
    assert frame.columns.tolist() == ["id", "states", "spec.task", "spec.method.name"]
    assert frame["spec.method.name"].tolist() == ["simopt"]


def test_no_rows_make_an_empty_frame():
    assert Rows().to_pandas().empty


def test_results_have_a_frame_for_each_table():
    results = Results(note="", rows=[{"method": "udr", "low": None}], costs=[])
    assert results.to_pandas()["low"].isna().tolist() == [True]
    assert results.to_pandas("costs").empty
    with pytest.raises(UnknownName, match="nothing"):
        results.to_pandas("nothing")
    with pytest.raises(UnknownName, match="note"):
        results.to_pandas("note")
