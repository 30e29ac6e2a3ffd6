"""Measurements as tables of text."""

import csv
import io
from collections.abc import Sequence
from typing import Any

import numpy as np

from adr_service.criticism.measurements import Measurement
from adr_service.errors import InvalidInput

_MOST_EXACT = 2**53  # numbers of a CSV are floats, and those from here on are rounded


def measurement_from_csv(text: str) -> Measurement:
    """Read a table with a header: `time`, `episode`, `qpos_0` …, `qvel_0` …, `ctrl_0` ….

    Raises InvalidInput with the line and column of what is wrong.
    """
    reader = csv.reader(io.StringIO(text.removeprefix("\ufeff")))
    try:
        lines = [(reader.line_num, line) for line in reader if line]
    except csv.Error as error:
        raise InvalidInput(f"line {reader.line_num} of the CSV: {error}") from error
    header = [name.strip() for name in lines[0][1]] if lines else []
    columns = {name: _numbered(header, name) for name in ("qpos", "qvel", "ctrl")}
    known = ["time", "episode", *(c for group in columns.values() for c in group)]
    if sorted(known) != sorted(header):
        raise InvalidInput(
            f"the CSV's header is {', '.join(header)}; expected are time, episode, and from 0 "
            "on qpos_0 …, qvel_0 …, ctrl_0 …, each once"
        )
    rows = [_numbers(number, line, header) for number, line in lines[1:]]
    table = np.array(rows, dtype=np.float64).reshape(len(rows), len(header))
    fields: dict[str, Any] = {
        n: table[:, [header.index(c) for c in group]] for n, group in columns.items()
    }
    episode = table[:, header.index("episode")]
    if not np.all(np.isfinite(episode) & (episode == np.round(episode))):
        raise InvalidInput("the CSV's episodes must be whole numbers")
    if (most := np.abs(episode).max(initial=0)) >= _MOST_EXACT:
        raise InvalidInput(
            f"the CSV's episodes must be whole numbers below 2**53; given up to {most:.16g}"
        )
    time = table[:, header.index("time")]
    return Measurement(time=time, episode=episode.astype(np.int64), **fields)


def _numbers(number: int, line: Sequence[str], header: Sequence[str]) -> list[float]:
    if len(line) != len(header):
        raise InvalidInput(
            f"line {number} of the CSV has {len(line)} values; the header has {len(header)}"
        )
    values: list[float] = []
    for name, value in zip(header, line, strict=True):
        try:
            values.append(float(value))
        except ValueError as error:
            raise InvalidInput(
                f"line {number} of the CSV has {value!r} for {name}; expected is a number"
            ) from error
    return values


def _numbered(header: Sequence[str], name: str) -> list[str]:
    count = sum(each.startswith(f"{name}_") for each in header)
    return [f"{name}_{i}" for i in range(count)]
