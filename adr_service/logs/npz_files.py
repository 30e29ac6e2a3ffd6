"""NumPy archives: every array with one row per reading is a column, or several."""

import numpy as np

from adr_service.arrays import Vector
from adr_service.errors import InvalidInput
from adr_service.logs.base import Log, Stream, check_size
from adr_service.npz import names_in, read_arrays


def read_npz(source: str, content: bytes) -> Log:
    """The log of an `.npz` of arrays (n,) or (n, k), whose columns become NAME_0 to NAME_(k - 1).

    The longest arrays have the log's rows; others, such as constants, are listed as unread. Raises
    InvalidInput unless it is an `.npz` of plain arrays.
    """
    try:
        arrays = read_arrays(content, names_in(content))
    except InvalidInput as error:
        raise InvalidInput(f"{source}: {error}") from error
    rows = max((len(each) for each in arrays.values() if _is_table(each)), default=0)
    if not rows:
        raise InvalidInput(f"{source} has no array with rows; it has {', '.join(arrays) or 'none'}")
    columns: dict[str, Vector] = {}
    unread: dict[str, str] = {}
    for name, values in arrays.items():
        if not _is_table(values) or len(values) != rows:
            unread[name] = (
                f"it is {values.dtype} of shape {values.shape}, and the log has {rows} rows"
            )
            continue
        parts = {name: values} if values.ndim == 1 else _places(name, values)
        if twice := sorted(columns.keys() & parts.keys()):
            raise InvalidInput(f"{source} has columns twice: {', '.join(twice[:5])}")
        columns.update({place: part.astype(np.float64) for place, part in parts.items()})
        check_size(source, len(columns), rows * len(columns))
    return Log(source, (Stream(columns),), unread)


def _is_table(values: np.ndarray) -> bool:
    return values.dtype.kind in "biuf" and values.ndim in (1, 2)


def _places(name: str, values: np.ndarray) -> dict[str, np.ndarray]:
    return {f"{name}_{i}": column for i, column in enumerate(values.T)}
