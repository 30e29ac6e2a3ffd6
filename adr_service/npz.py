"""`.npz` files from untrusted sources: checked by their headers, then loaded.

arrays = read_arrays(content, ["time", "qpos"])     # InvalidInput says what is wrong
"""

import io
import math
import tokenize
import zipfile
from collections.abc import Mapping, Sequence

import numpy as np
from numpy.lib import format as npy
from numpy.typing import ArrayLike

from adr_service.errors import InvalidInput
from adr_service.json_values import is_a_line
from adr_service.zips import BROKEN, check_directory, check_size, stored

_MOST_NUMBERS = 2**25  # of all arrays together: 256 MB as float64
_MOST_TEXTS = 10_000
_WIDEST = 8  # bytes of a number
_LONGEST_LIST = 100_000  # bytes of the zip's list of members
_LONGEST_HEADER = 20_000  # bytes of an array; NumPy reads 10,000 of those that say more
# by NumPy, beside its ValueError
_BAD_HEADER = (IndexError, KeyError, TypeError, MemoryError, SyntaxError, tokenize.TokenError)
_KINDS = "biufU"  # booleans, integers, floats, texts; never objects


def read_arrays(
    content: bytes,
    accepted: Sequence[str],
    longest: int | None = None,
    *,
    most: int = _MOST_NUMBERS,
) -> dict[str, np.ndarray]:
    """The arrays of an `.npz`, by name; all names must be `accepted` ones.

    No array may have more than `longest` rows, and all together no more than `most` numbers. Runs
    no code from the file, and unpacks no more than its headers announce.
    """
    if not content.startswith(b"PK"):  # a zip file may hide behind something else
        raise InvalidInput("not a readable .npz: it does not begin as one")
    try:
        with _opened(content) as archive:
            members = archive.infolist()
            _check_names([member.filename for member in members], accepted)
            check_size(members, len(content), ".npz")
            numbers = sum(_check_header(archive, member, longest) for member in members)
            if numbers > most:
                raise InvalidInput(f"the .npz holds {numbers} numbers; accepted are {most}")
            return {m.filename.removesuffix(".npy"): _read(archive, m) for m in members}
    except BROKEN as error:
        raise InvalidInput(f"not a readable .npz of plain arrays: {error}") from error


def write_arrays(arrays: Mapping[str, ArrayLike]) -> bytes:
    """The bytes of an `.npz` of these arrays; the same arrays always give the same bytes.

    `np.savez` gives others before Python 3.11.4 than since. Raises ValueError for objects.
    """
    members: dict[str, bytes] = {}
    for name, array in arrays.items():
        file = io.BytesIO()
        npy.write_array(file, np.asanyarray(array), allow_pickle=False)
        members[f"{name}.npy"] = file.getvalue()
    return stored(members)


def names_in(content: bytes) -> list[str]:
    """The names of an `.npz`'s arrays; an empty list if it cannot be read."""
    try:
        with _opened(content) as archive:
            return [name.removesuffix(".npy") for name in archive.namelist()]
    except (*BROKEN, InvalidInput):
        return []


def _opened(content: bytes) -> zipfile.ZipFile:
    check_directory(io.BytesIO(content), _LONGEST_LIST, ".npz")
    return zipfile.ZipFile(io.BytesIO(content))


def _check_names(names: Sequence[str], accepted: Sequence[str]) -> None:
    files = {f"{name}.npy" for name in accepted}
    if unknown := [name for name in names if name not in files][:5]:
        raise InvalidInput(f"the .npz has {unknown}; accepted: {', '.join(sorted(files))}")
    if len(set(names)) < len(names):
        raise InvalidInput(f"the .npz has a member twice: {', '.join(sorted(names))}")


def _check_header(archive: zipfile.ZipFile, member: zipfile.ZipInfo, longest: int | None) -> int:
    """Check an array's header, and return how many numbers the array has."""
    with archive.open(member) as packed:
        file = io.BytesIO(packed.read(_LONGEST_HEADER))
    version = npy.read_magic(file)
    read_header = npy.read_array_header_1_0 if version == (1, 0) else npy.read_array_header_2_0
    try:
        shape, _, dtype = read_header(file)
    except _BAD_HEADER as error:
        raise InvalidInput(f"{member.filename} has an unreadable header: {error}") from error
    if not all(type(length) is int for length in shape):
        raise InvalidInput(f"{member.filename} has the shape {shape}; accepted are whole numbers")
    count = math.prod(shape)
    if longest is not None and shape and shape[0] > longest:
        raise InvalidInput(f"{member.filename} has {shape[0]} rows; accepted are {longest} at most")
    wide = dtype.kind != "U" and dtype.itemsize > _WIDEST
    if dtype.hasobject or dtype.kind not in _KINDS or dtype.itemsize == 0 or wide:
        raise InvalidInput(f"{member.filename} holds {dtype}; accepted are numbers and texts")
    if dtype.kind == "U" and count > _MOST_TEXTS:
        raise InvalidInput(f"{member.filename} holds {count} texts; accepted: {_MOST_TEXTS}")
    if file.tell() + count * dtype.itemsize != member.file_size:
        raise InvalidInput(f"{member.filename} is not as long as its shape {shape} says")
    # a character takes the room of a number
    return count * (dtype.itemsize // 4 if dtype.kind == "U" else 1)


def _read(archive: zipfile.ZipFile, member: zipfile.ZipInfo) -> np.ndarray:
    with archive.open(member) as file:
        array = npy.read_array(file, allow_pickle=False)
    if array.dtype.kind == "U":
        whole = "".join(array.ravel().tolist())
        whole.encode()  # no half characters
        if not is_a_line(whole):
            raise InvalidInput(f"{member.filename} has control characters in its texts")
    return array
