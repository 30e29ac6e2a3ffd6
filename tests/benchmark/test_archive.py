"""The file of an archive: what a reader accepts, and what it refuses."""

import io
import json
import zipfile

import pytest

from adr_service.benchmark.archive import ArchiveReader, ArchiveWriter, Manifest
from adr_service.errors import InvalidInput
from adr_service.json_values import sha256

MANIFEST = Manifest(
    benchmark="bench_0123456789abcdef",
    adr_service="0.1.0",
    revision="0009",
    computed_with=[{"cpu": "one", "numpy": "2.5"}],
)
ROWS = [{"id": "a", "number": 1, "share": 0.1, "nothing": None}, {"id": "b"}]
BLOB = bytes(range(256)) * 10


def archive(manifest=MANIFEST):
    """An archive of two rows and one blob, as a file at its start."""
    file = io.BytesIO()
    with ArchiveWriter(file) as writer:
        writer.add_rows("runs", ROWS)
        writer.add_blob(BLOB)
        writer.finish(manifest)
    return file


def zipped(members):
    """A zip of (name, content) pairs."""
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED) as written:
        for name, content in members:
            written.writestr(name, content)
    return file


def manifest(**changes):
    return "manifest.json", json.dumps({**MANIFEST.model_dump(), **changes})


def test_content_comes_back_as_it_was_written():
    with ArchiveReader(archive()) as reader:
        assert reader.manifest == MANIFEST
        assert reader.tables == {"runs"}
        assert list(reader.rows("runs")) == ROWS
        assert reader.blobs == [sha256(BLOB)]
        assert reader.blob(sha256(BLOB)) == BLOB


def test_an_archive_has_no_pickles_and_no_dates():
    with zipfile.ZipFile(archive()) as read:
        assert {info.date_time for info in read.infolist()} == {(1980, 1, 1, 0, 0, 0)}
        names = read.namelist()
    assert names == ["tables/runs.jsonl", f"blobs/{sha256(BLOB)}", "manifest.json"]


@pytest.mark.parametrize("cut", [1, 50, 300])
def test_an_archive_that_is_cut_short_is_refused(cut):
    whole = archive().getvalue()
    with pytest.raises(InvalidInput, match="not a readable archive"):
        ArchiveReader(io.BytesIO(whole[:-cut]))


def test_an_archive_whose_writer_died_has_no_manifest():
    file = io.BytesIO()
    with ArchiveWriter(file) as writer:
        writer.add_rows("runs", ROWS)
    with pytest.raises(InvalidInput, match="no manifest"):
        ArchiveReader(file)


def test_every_flipped_byte_is_noticed_or_changes_nothing():
    whole = archive().getvalue()
    for position in range(0, len(whole), 7):
        changed = bytearray(whole)
        changed[position] ^= 0x10
        try:
            with ArchiveReader(io.BytesIO(bytes(changed))) as reader:
                content = list(reader.rows("runs")), reader.blob(sha256(BLOB)), reader.manifest
        except (InvalidInput, KeyError):
            continue
        assert content == (ROWS, BLOB, MANIFEST)


REFUSED = {
    "a path": ([manifest(), ("../../etc/passwd", "x")], "this has"),
    "an absolute path": ([manifest(), ("/tmp/x", "x")], "this has"),  # noqa: S108
    "a pickle": ([manifest(), ("blobs/model.pkl", "x")], "this has"),
    "a format to come": ([manifest(format=2)], "format 2"),
    "no format": ([("manifest.json", "{}")], "format None"),
    "an unknown field": ([manifest(evil=1)], "evil"),
    "a field of another type": ([manifest(revision=9)], "revision"),
    "a manifest that is a list": ([("manifest.json", "[]")], "no JSON object"),
    "a manifest without end": ([("manifest.json", "[" * 100_000)], "no JSON"),
    "control characters": ([manifest(benchmark="\x1b[2J")], "benchmark"),
    "a bomb": ([manifest(), ("tables/runs.jsonl", b"\0" * 50_000_000)], "would unpack to"),
    "a large blob": (
        [manifest(), (f"blobs/{'0' * 64}", bytes(256_000_001))],
        "accepted are 256000000",
    ),
}


@pytest.mark.parametrize("name", REFUSED)
def test_a_hostile_archive_is_refused(name):
    members, message = REFUSED[name]
    with pytest.raises(InvalidInput, match=message):
        ArchiveReader(zipped(members))


def test_a_member_that_comes_twice_is_refused():
    with pytest.warns(UserWarning, match="Duplicate name"):
        file = zipped([manifest(), manifest()])
    with pytest.raises(InvalidInput, match="a member twice"):
        ArchiveReader(file)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (b'{"id": "a"}', "cut short"),
        (b"[1]\n", "no JSON object"),
        (b"{\n", "no JSON"),
        (b'{"id": {"evil": 1}}\n', "nested values"),
        (b"\xff\xfe\n", "no JSON"),
    ],
)
def test_a_row_that_is_no_row_is_refused(text, message):
    reader = ArchiveReader(zipped([manifest(), ("tables/runs.jsonl", text)]))
    with pytest.raises(InvalidInput, match=message):
        list(reader.rows("runs"))


def test_a_blob_under_another_name_is_refused():
    reader = ArchiveReader(zipped([manifest(), (f"blobs/{'0' * 64}", b"evil")]))
    with pytest.raises(InvalidInput, match="other bytes than its name says"):
        reader.blob("0" * 64)
