"""Measurements as tables of text."""

import numpy as np
import pytest

from adr_service.criticism.csv_tables import measurement_from_csv
from adr_service.errors import InvalidInput


def as_csv(fields):
    wide = [(n, fields[n]) for n in ("qpos", "qvel", "ctrl")]
    header = ["time", "episode", *(f"{n}_{i}" for n, v in wide for i in range(v.shape[1]))]
    table = np.column_stack([fields["time"], fields["episode"], *(v for _, v in wide)])
    lines = [",".join(map(repr, row)) for row in table.tolist()]
    return "\n".join([",".join(header), *lines])


def test_a_table_is_the_same_measurement_as_its_arrays(good):
    measured = measurement_from_csv(as_csv(good))
    for name, values in good.items():
        np.testing.assert_array_equal(getattr(measured, name), values)


@pytest.mark.parametrize(
    ("before", "after", "message"),
    [
        ("qvel_1", "qvel_7", "expected are time, episode, and from 0 on qpos_0"),
        ("0.0,0.0,", "0.0,first,", "line 2 of the CSV has 'first' for episode"),
        ("0.0,0.0,", "0.0,", "line 2 of the CSV has 7 values; the header has 8"),
        ("0.0,0.0,", "0.0,0.5,", "episodes must be whole numbers"),
        ("0.0,0.0,", "0.0,inf,", "episodes must be whole numbers"),
        ("0.0,0.0,", "0.0,-1e300,", "whole numbers below 2..53; given up to 1e.300"),
        ("0.0,0.0,", "0.0,9007199254740993,", "given up to 9007199254740992"),
        ("\n0.0,0.0,", "\n\n\n0.0,first,", "line 4 of the CSV has 'first'"),
    ],
)
def test_a_table_that_is_wrong_is_refused_with_its_line(good, before, after, message):
    with pytest.raises(InvalidInput, match=message):
        measurement_from_csv(as_csv(good).replace(before, after, 1))
