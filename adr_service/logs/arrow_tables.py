"""Columns of numbers of an Arrow table; lists of numbers become one column for each place."""

from typing import Any

import numpy as np

from adr_service.arrays import Vector
from adr_service.errors import InvalidInput
from adr_service.logs.base import check_size


def columns_of(source: str, table: Any) -> tuple[dict[str, Vector], tuple[str, ...]]:
    """Columns (n,) of a `pyarrow.Table` by name, and the names of those without numbers.

    An empty cell is NaN. A list of k numbers in each row becomes the columns NAME_0 to
    NAME_(k - 1). Raises InvalidInput if two columns have one name.
    """
    import pyarrow as pa

    names: list[str] = table.column_names
    if twice := sorted({name for name in names if names.count(name) > 1}):
        raise InvalidInput(f"{source} has columns twice: {', '.join(twice[:5])}")
    check_size(source, table.num_columns, table.num_columns * table.num_rows)
    columns: dict[str, Vector] = {}
    texts: list[str] = []
    for name in names:
        column = table[name].combine_chunks()
        if pa.types.is_list(column.type) or pa.types.is_fixed_size_list(column.type):
            parts = _listed(column)
            check_size(source, len(parts), len(parts) * table.num_rows)
            columns.update({f"{name}_{i}": part for i, part in enumerate(parts)})
        elif (values := _numbers(column)) is not None:
            columns[name] = values
        else:
            texts.append(name)
    return columns, tuple(texts)


def _listed(column: Any) -> list[Vector]:
    """The places of a column of lists, which must all be of the same length."""
    lengths = np.unique(column.value_lengths().drop_null().to_numpy())
    if len(lengths) != 1:
        return []
    values = _numbers(column.flatten())
    if values is None or len(values) != len(column) * lengths[0]:
        return []
    return list(values.reshape(len(column), int(lengths[0])).T.copy())


def _numbers(array: Any) -> Vector | None:
    """(n,) the values, or None if they are no numbers; times become seconds since 1970."""
    import pyarrow as pa

    kind = array.type
    if pa.types.is_timestamp(kind):
        nanoseconds = array.cast(pa.timestamp("ns", kind.tz)).cast(pa.int64())
        return np.asarray(nanoseconds.to_numpy(zero_copy_only=False), dtype=np.float64) * 1e-9
    if pa.types.is_boolean(kind) or pa.types.is_integer(kind) or pa.types.is_floating(kind):
        return np.asarray(array.cast(pa.float64()).to_numpy(zero_copy_only=False))
    if pa.types.is_null(kind):
        return np.full(len(array), np.nan)
    return None
