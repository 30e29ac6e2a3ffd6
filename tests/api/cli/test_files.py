"""Files that commands read and write."""

import pytest

from adr_service.errors import InvalidInput
from api.cli.files import check_writable


def test_what_cannot_be_written_is_refused_before_the_work(tmp_path):
    (tmp_path / "taken").write_text("")
    with pytest.raises(InvalidInput, match=r"taken.found.a cannot be written: "):
        check_writable(tmp_path / "taken" / "found" / "a")
    with pytest.raises(InvalidInput, match="taken is there already"):
        check_writable(tmp_path / "b", tmp_path / "taken")


def test_what_can_be_written_has_its_folder_and_nothing_else(tmp_path):
    check_writable(tmp_path / "new" / "a", tmp_path / "new" / "b")
    assert list(tmp_path.rglob("*")) == [tmp_path / "new"]
