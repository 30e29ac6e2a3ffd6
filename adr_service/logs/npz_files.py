"""NumPy archives: every array with one row per reading is a column, or several."""

from collections import Counter

import numpy as np

from adr_service.arrays import Vector
from adr_service.errors import InvalidInput
from adr_service.logs.base import Log, Stream, check_size
from adr_service.npz import names_in, read_arrays


def read_npz(source: str, content: bytes) -> Log:
    """The log of an `.npz` of arrays (n,) or (n, k), whose columns become NAME_0 to NAME_(k - 1).

    Arrays of another length, such as constants, are left out like texts. Raises InvalidInput for
    what is no `.npz` of plain arrays.
    """
    arrays = read_arrays(content, names_in(content))
    lengths = Counter(len(each) for each in arrays.values() if each.ndim in (1, 2))
    if not lengths:
        raise InvalidInput(f"{source} has no array with rows; it has {', '.join(arrays) or 'none'}")
    rows, _ = lengths.most_common(1)[0]
    columns: dict[str, Vector] = {}
    texts: list[str] = []
    for name, values in arrays.items():
        if values.dtype.kind not in "biuf" or values.ndim not in (1, 2) or len(values) != rows:
            texts.append(name)
        elif values.ndim == 1:
            columns[name] = values.astype(np.float64)
        else:
            columns.update({f"{name}_{i}": c.astype(np.float64) for i, c in enumerate(values.T)})
    check_size(source, len(columns), rows * len(columns))
    return Log(source, (Stream(columns),), tuple(texts))
