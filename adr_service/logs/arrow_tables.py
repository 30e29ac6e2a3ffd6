"""Columns of numbers of an Arrow table; lists of numbers become one column for each place."""

from importlib import import_module
from typing import Any

import numpy as np

from adr_service.arrays import Vector
from adr_service.errors import InvalidInput
from adr_service.logs.base import Stream, check_size

_SHOWN = 40  # characters of a text
_NUMBER = r"^\s*[+-]?(\d+[.,]?\d*|[.,]\d+)([eE][+-]?\d+)?\s*$"


def stream_of(source: str, table: Any) -> tuple[Stream, dict[str, str]]:
    """The columns of a `pyarrow.Table`, and why others cannot be read.

    An empty cell is NaN, in all places of a list. A list of k numbers in each row becomes the
    columns NAME_0 to NAME_(k - 1). Raises InvalidInput if two columns have one name.
    """
    check_size(source, table.num_columns, table.num_columns * table.num_rows)
    columns: dict[str, Vector] = {}
    unread: dict[str, str] = {}
    for name, column in zip(table.column_names, table.columns, strict=True):
        found = _places(name, column.combine_chunks())
        if isinstance(found, str):
            unread[name] = found
            continue
        if twice := sorted(columns.keys() & found.keys()):
            raise InvalidInput(f"{source} has columns twice: {', '.join(twice[:5])}")
        columns.update(found)
        check_size(source, len(columns), len(columns) * table.num_rows)
    kinds = zip(table.column_names, table.schema.types, strict=True)
    return Stream(columns, dated=frozenset(n for n, kind in kinds if _is_date(kind))), unread


def _is_date(kind: Any) -> bool:
    import pyarrow as pa

    return bool(pa.types.is_timestamp(kind))


def _places(name: str, column: Any) -> dict[str, Vector] | str:
    """A column by its name, or a list's places by theirs, or why there are none."""
    import pyarrow as pa

    kind = column.type
    if not (pa.types.is_list(kind) or pa.types.is_large_list(kind) or _is_fixed(kind)):
        values = _numbers(column)
        return _what_it_holds(column) if values is None else {name: values}
    lengths = np.unique(column.value_lengths().drop_null().to_numpy(zero_copy_only=False))
    values = _numbers(column.flatten())
    if values is None:
        return f"it holds {kind}"
    if len(lengths) != 1:
        return "its lists are not all of one length" if len(lengths) else "all its cells are empty"
    has_list, length = np.asarray(column.is_valid()), int(lengths[0])
    table = np.full((len(column), length), np.nan)  # an empty cell is no reading
    table[has_list] = values.reshape(int(has_list.sum()), length)
    return {f"{name}_{i}": place for i, place in enumerate(table.T.copy())}


def _what_it_holds(column: Any) -> str:
    """Describe a column without numbers: the first odd cell of a text, else its type.

    The odd cell is one without a number, or else any; or one cell with each of two decimal marks.
    """
    import pyarrow as pa
    from pyarrow import csv

    pc: Any = import_module("pyarrow.compute")  # its functions are made when it is imported
    kind = column.type
    if not (pa.types.is_string(kind) or pa.types.is_large_string(kind)):
        return f"it holds {kind}"
    empty = pa.array([*csv.ConvertOptions().null_values, None])
    cells = column.filter(pc.invert(pc.is_in(column, empty)))
    if not len(cells):
        return f"it holds {kind}"

    def first(found: Any) -> str:
        row = pc.index(column, found).as_py() + 1
        return f"{found.as_py()[:_SHOWN]!r}, first in row {row} below the header"

    odd = pc.index(pc.match_substring_regex(cells, _NUMBER), False).as_py()
    marks = [cells.filter(pc.match_substring(cells, mark)) for mark in ",."]
    if odd < 0 and all(map(len, marks)):
        comma, point = (first(each[0]) for each in marks)
        return f"it has two decimal marks: {comma}, and {point}; accepted is one"
    return f"it holds the text {first(cells[max(odd, 0)])}; accepted are numbers"


def _is_fixed(kind: Any) -> bool:
    import pyarrow as pa

    return bool(pa.types.is_fixed_size_list(kind))


def _numbers(array: Any) -> Vector | None:
    """(n,) the values, or None if they are no numbers; times become seconds since 1970."""
    import pyarrow as pa

    kind = array.type
    if _is_date(kind):
        nanoseconds = array.cast(pa.timestamp("ns", kind.tz)).cast(pa.int64())
        return np.asarray(nanoseconds.to_numpy(zero_copy_only=False), dtype=np.float64) * 1e-9
    if pa.types.is_boolean(kind) or pa.types.is_integer(kind) or pa.types.is_floating(kind):
        return np.asarray(array.cast(pa.float64(), safe=False).to_numpy(zero_copy_only=False))
    if pa.types.is_null(kind):
        return np.full(len(array), np.nan)
    return None
