"""Zip files of ours, with the same bytes on every Python, and those from untrusted sources: what
their readers raise, and how much they may unpack to."""

import lzma
import os
import struct
import zipfile
import zlib
from collections.abc import Mapping, Sequence
from typing import IO

from adr_service.errors import InvalidInput

_MOST_PACKED = 200  # times as long as the file
_ALWAYS_UNPACKED = 8_000_000  # bytes that even the smallest file may unpack to
_END = struct.Struct("<4s4H2LH")  # the end of a zip: APPNOTE.TXT 4.3.16
_END_64 = struct.Struct("<4sQ2H2L4Q")  # of a large one: 4.3.14
_LOCATOR_64 = struct.Struct("<4sLQL")  # says where that is: 4.3.15
_LOCAL = struct.Struct("<4s5H3L2H")  # before a member: 4.3.7
_SIZES_64 = struct.Struct("<2H2Q")  # its sizes where they are not in _LOCAL: 4.5.3
_LISTED = struct.Struct("<4s6H3L5H2L")  # a member in the list: 4.3.12
_VERSION_64 = 45  # of the format, with sizes of 64 bits
_BY_UNIX = 3 << 8
_NEW_YEAR_1980 = (0, 0x21)  # time and date
_FOR_OWNER = 0o600 << 16  # to read and write
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


def stored(members: Mapping[str, bytes]) -> bytes:
    """A zip of these members, which are not compressed; names are ASCII.

    Its bytes are those of `zipfile`'s `open(name, "w", force_zip64=True)` since Python 3.11.4.
    Before, its headers had others. Results are found by the bytes that they were computed from.
    """
    parts: list[bytes] = []
    listed: list[bytes] = []
    offset = 0
    for text, content in members.items():
        name, crc, size = text.encode("ascii"), zlib.crc32(content), len(content)
        kind = (_VERSION_64, 0, zipfile.ZIP_STORED, *_NEW_YEAR_1980, crc)
        lengths = (len(name), _SIZES_64.size)
        local = _LOCAL.pack(b"PK\x03\x04", *kind, 0xFFFFFFFF, 0xFFFFFFFF, *lengths)
        local += name + _SIZES_64.pack(1, 16, size, size)
        place = (len(name), 0, 0, 0, 0, _FOR_OWNER, offset)
        by = _VERSION_64 | _BY_UNIX
        listed.append(_LISTED.pack(b"PK\x01\x02", by, *kind, size, size, *place) + name)
        parts += [local, content]
        offset += len(local) + size
    directory = b"".join(listed)
    counts = (0, 0, len(members), len(members))
    end = _END.pack(b"PK\x05\x06", *counts, len(directory), offset, 0)
    return b"".join([*parts, directory, end])


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
        # older Pythons believe the record before the locator, newer ones that at its offset first
        listed = max(listed, int(_END_64.unpack_from(tail, locator - _END_64.size)[8]))
        file.seek(min(int(_LOCATOR_64.unpack_from(tail, locator)[2]), size))
        at_offset = file.read(_END_64.size)
        if len(at_offset) == _END_64.size and at_offset.startswith(b"PK\x06\x06"):
            listed = max(listed, int(_END_64.unpack(at_offset)[8]))
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
