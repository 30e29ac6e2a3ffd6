"""Files that are written as a whole or not at all."""

import errno
import os
import stat
from contextlib import nullcontext

import pytest

from adr_service.whole_files import written_whole


def test_a_file_is_there_once_all_of_it_is_written(tmp_path):
    path = tmp_path / "a.json"
    with written_whole(path, mode=0o600) as part:
        part.write_text("new")
        assert not path.exists()
    assert path.read_text() == "new"
    assert stat.S_IMODE(path.stat().st_mode) == 0o600
    assert list(tmp_path.iterdir()) == [path]


def test_what_was_there_stays_if_writing_fails(tmp_path):
    path = tmp_path / "a.json"
    path.write_text("old")
    with pytest.raises(UnicodeEncodeError), written_whole(path) as part:
        part.write_text("half\udfff", encoding="utf-8")  # this cannot be encoded
    assert path.read_text() == "old"
    assert list(tmp_path.iterdir()) == [path]


def test_what_a_killed_process_left_is_written_anew(tmp_path):
    path = tmp_path / "a.json"
    (tmp_path / "a.json.part").write_text("half of much more")
    with written_whole(path) as part:
        assert part.read_text() == ""
        part.write_text("new")
    assert path.read_text() == "new"


@pytest.mark.parametrize(("refusal", "is_told"), [(errno.EINVAL, False), (errno.EIO, True)])
def test_a_file_system_that_cannot_sync_folders_is_no_failure(
    tmp_path, monkeypatch, refusal, is_told
):
    sync = os.fsync

    def sync_files(opened):
        if stat.S_ISDIR(os.fstat(opened).st_mode):
            raise OSError(refusal, os.strerror(refusal))
        sync(opened)

    monkeypatch.setattr(os, "fsync", sync_files)
    path = tmp_path / "a.json"
    told = pytest.raises(OSError, match="error") if is_told else nullcontext()
    with told, written_whole(path) as part:
        part.write_text("new")
    assert path.read_text() == "new"
