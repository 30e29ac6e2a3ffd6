"""Formats by ending."""

import pytest

from adr_service.errors import InvalidInput
from adr_service.logs.catalogue import read_logs


def test_another_ending_lists_those_accepted(tmp_path):
    with pytest.raises(InvalidInput, match=r"ends on '.xlsx'; accepted are .csv, .tsv"):
        read_logs(tmp_path / "log.xlsx")


def test_a_missing_file_is_refused(tmp_path):
    with pytest.raises(InvalidInput, match=r"log\.csv cannot be read"):
        read_logs(tmp_path / "log.csv")
