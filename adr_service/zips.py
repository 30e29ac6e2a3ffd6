"""Zip files from untrusted sources: what their readers raise, and how much they may unpack to."""

import lzma
import os
import struct
import zipfile
import zlib
from collections.abc import Sequence
from typing import IO

from adr_service.errors import InvalidInput

_MOST_PACKED = 200  # times as long as the file
_ALWAYS_UNPACKED = 8_000_000  # bytes that even the smallest file may unpack to
_END = struct.Struct("<4s4H2LH")  # the end of a zip: APPNOTE.TXT 4.3.16
_END_64 = struct.Struct("<4sQ2H2L4Q")  # of a large one: 4.3.14
_LOCATOR_64 = struct.Struct("<4sLQL")  # says where that is: 4.3.15
BROKEN = (  # raised by the readers of a damaged or malicious file
    zipfile.BadZipFile,
    zlib.error,
    lzma.LZMAError,
    struct.error,
    EOFError,
    OSError,
    ValueError,  # and so UnicodeError
    OverflowError,
    NotImplementedError,
    RuntimeError,
    SystemError,
)


def check_directory(file: IO[bytes], largest: int, kind: str) -> None:
    """Refuse a zip whose list of members has more than `largest` bytes: it is read at once."""
    size = file.seek(0, os.SEEK_END)
    before = _END_64.size + _LOCATOR_64.size
    length = min(size, before + _END.size + 2**16)  # a comment may follow
    file.seek(size - length)
    tail = file.read(length)
    place = tail.rfind(b"PK\x05\x06")
    if place < 0 or len(tail) - place < _END.size:
        raise zipfile.BadZipFile("it is no zip, or is cut short")
    listed = int(_END.unpack_from(tail, place)[5])
    locator = place - _LOCATOR_64.size
    if locator >= _END_64.size and tail.startswith(b"PK\x06\x07", locator):
        # Python's reader believes this record, wherever the locator says that it is
        listed = max(listed, int(_END_64.unpack_from(tail, locator - _END_64.size)[8]))
    if listed > largest:
        raise InvalidInput(
            f"the {kind}'s list of members has {listed} bytes; accepted are {largest}"
        )


def check_size(members: Sequence[zipfile.ZipInfo], packed: int, kind: str) -> None:
    """Refuse a file of `packed` bytes that would unpack to many times its own size."""
    unpacked = sum(member.file_size for member in members)
    if unpacked > max(_ALWAYS_UNPACKED, _MOST_PACKED * packed):
        raise InvalidInput(
            f"the {kind} of {packed} bytes would unpack to {unpacked}; accepted are {_MOST_PACKED} "
            "times as many, which files of results and recordings never reach"
        )
