"""Reading `.npz` files that anybody may have written: checked by headers, then loaded.

arrays = read_arrays(content)           # name -> array; InvalidInput says what is wrong
"""

import io
import math
import zipfile

import numpy as np
from numpy.lib import format as npy

from adr_service.errors import InvalidInput

_MOST_BYTES = 2**29  # of all arrays together, unpacked
_KINDS = "biufU"  # booleans, integers, floats, texts; never objects


def read_arrays(content: bytes) -> dict[str, np.ndarray]:
    """The arrays of an `.npz`; never runs code from it, nor unpacks more than its headers say."""
    try:
        with zipfile.ZipFile(io.BytesIO(content)) as archive:
            members = archive.infolist()
            _check_directory(members)
            return {m.filename.removesuffix(".npy"): _read(archive, m) for m in members}
    except (ValueError, zipfile.BadZipFile, EOFError, NotImplementedError, RuntimeError) as error:
        raise InvalidInput(f"not a readable .npz of plain arrays: {error}") from error


def _check_directory(members: list[zipfile.ZipInfo]) -> None:
    names = [member.filename for member in members]
    for name in names:
        if not name.endswith(".npy") or "/" in name or "\\" in name:
            raise InvalidInput(f"an .npz holds arrays NAME.npy and nothing else; given {name!r}")
        if names.count(name) > 1:
            raise InvalidInput(f"the .npz has two members {name!r}")
    unpacked = sum(member.file_size for member in members)
    if unpacked > _MOST_BYTES:
        raise InvalidInput(
            f"the .npz unpacks to {unpacked / 1e6:.0f} MB; accepted are {_MOST_BYTES / 1e6:.0f} MB"
        )


def _read(archive: zipfile.ZipFile, member: zipfile.ZipInfo) -> np.ndarray:
    with archive.open(member) as file:
        version = npy.read_magic(file)
        read_header = npy.read_array_header_1_0 if version == (1, 0) else npy.read_array_header_2_0
        shape, _, dtype = read_header(file)
        if dtype.hasobject or dtype.kind not in _KINDS:
            raise InvalidInput(f"{member.filename} holds {dtype}; accepted are numbers and texts")
        if file.tell() + math.prod(shape) * dtype.itemsize != member.file_size:
            raise InvalidInput(f"{member.filename} is not as long as its shape {shape} says")
    with archive.open(member) as file:
        return npy.read_array(file, allow_pickle=False)
