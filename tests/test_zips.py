"""The largest size to which a zip from elsewhere may unpack."""

import zipfile

import pytest

from adr_service.errors import InvalidInput
from adr_service.zips import check_size


def members(size):
    info = zipfile.ZipInfo("a")
    info.file_size = size
    return [info]


def test_a_small_file_may_unpack_to_eight_megabytes():
    check_size(members(8_000_000), 100, "archive")
    with pytest.raises(InvalidInput, match="the archive of 100 bytes would unpack to 8000001"):
        check_size(members(8_000_001), 100, "archive")


def test_a_large_file_may_unpack_to_two_hundred_times_its_size():
    check_size(members(200_000_000), 1_000_000, "archive")
    with pytest.raises(InvalidInput, match="200 times as many"):
        check_size(members(200_000_001), 1_000_000, "archive")
