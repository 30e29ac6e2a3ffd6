"""Zip files from untrusted sources: what their readers raise, and how much they may unpack to."""

import lzma
import struct
import zipfile
import zlib
from collections.abc import Sequence

from adr_service.errors import InvalidInput

_MOST_PACKED = 200  # times as long as the file
_ALWAYS_UNPACKED = 8_000_000  # bytes that even the smallest file may unpack to
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


def check_size(members: Sequence[zipfile.ZipInfo], packed: int, kind: str) -> None:
    """Refuse a file of `packed` bytes that would unpack to many times its own size."""
    unpacked = sum(member.file_size for member in members)
    if unpacked > max(_ALWAYS_UNPACKED, _MOST_PACKED * packed):
        raise InvalidInput(
            f"the {kind} of {packed} bytes would unpack to {unpacked}; accepted are {_MOST_PACKED} "
            "times as many, which files of results and recordings never reach"
        )
