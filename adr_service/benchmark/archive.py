"""The file of an archive: a benchmark's rows and bytes in a zip, without code or pickles.

    with ArchiveWriter(file) as archive:
        archive.add_rows("runs", rows)              # tables/runs.jsonl
        archive.add_blob(content)                   # blobs/<SHA-256>
        archive.finish(manifest)                    # manifest.json

    with ArchiveReader(file) as archive:            # InvalidInput unless it is whole and harmless
        for row in archive.rows("runs"):
            print(row)

Rows are the database's own, in JSON, and the manifest names the revision of its tables, so that
the migrations of later versions apply to archives too. The same content gives the same bytes.
"""

import json
import os
import re
import zipfile
from collections.abc import Generator, Iterable, Iterator
from contextlib import contextmanager
from typing import IO, Any, Literal, Self, cast

from pydantic import Field, ValidationError

from adr_service.errors import InvalidInput
from adr_service.json_values import Line, Wire, canonical_json, explain, sha256
from adr_service.zips import BROKEN, check_directory, check_size

_MANIFEST = "manifest.json"
_NAME = re.compile(r"manifest\.json|tables/[a-z_]{1,40}\.jsonl|blobs/[0-9a-f]{64}")
_EARLIEST = (1980, 1, 1, 0, 0, 0)  # the date of every member
_LONGEST_LINE = 16_000_000  # bytes of a row
_LARGEST_BLOB = 256_000_000  # bytes
_LARGEST_MANIFEST = 10_000_000  # bytes
_LARGEST_DIRECTORY = 200_000_000  # bytes of the zip's list of members, which is read at once


class Manifest(Wire):
    """The benchmark of an archive, and the versions that wrote it."""

    format: Literal[1] = 1
    benchmark: Line  # its id
    adr_service: Line  # version
    revision: Line  # of the database's tables
    # where its stages were computed: versions of packages and type of CPU, each combination once
    # by machine, and then each package that adds a task or a method
    computed_with: list[dict[Line, Line]] = Field(max_length=10_000)


class ArchiveWriter:
    """An archive that is being written, member after member."""

    def __init__(self, file: IO[bytes]):
        self._zip = zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._zip.close()

    def add_rows(self, table: str, rows: Iterable[dict[str, Any]]) -> None:
        """Write all rows of a table, one after the other."""
        with self._zip.open(_member(f"tables/{table}.jsonl"), "w", force_zip64=True) as file:
            for row in rows:
                file.write(canonical_json(row).encode() + b"\n")

    def add_blob(self, content: bytes) -> None:
        """Write bytes under their SHA-256; each content once."""
        self._zip.writestr(_member(f"blobs/{sha256(content)}"), content)

    def finish(self, manifest: Manifest) -> None:
        """Write the manifest; without it no reader accepts the file."""
        text = canonical_json(manifest.model_dump(mode="json"))
        self._zip.writestr(_member(_MANIFEST), text)


class ArchiveReader:
    """An archive from an untrusted source. Raises InvalidInput where it is damaged or too large."""

    def __init__(self, file: IO[bytes]):
        size = file.seek(0, os.SEEK_END)
        with _readable():
            check_directory(file, _LARGEST_DIRECTORY, "archive")
            self._zip = zipfile.ZipFile(file)
        try:
            self._check_members(size)
            self.manifest = self._read_manifest()
        except BaseException:
            self._zip.close()
            raise

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._zip.close()

    @property
    def tables(self) -> set[str]:
        """Names of the tables that it has rows of."""
        return {name[7:-6] for name in self._zip.namelist() if name.startswith("tables/")}

    @property
    def unpacked(self) -> int:
        """Bytes of all its members, unpacked."""
        return sum(member.file_size for member in self._zip.infolist())

    @property
    def blobs(self) -> list[str]:
        """The SHA-256 of all its blobs."""
        return [name[6:] for name in self._zip.namelist() if name.startswith("blobs/")]

    def rows(self, table: str) -> Iterator[dict[str, Any]]:
        """The rows of a table, each a JSON object of plain values."""
        with _readable(), self._zip.open(f"tables/{table}.jsonl") as file:
            while line := file.readline(_LONGEST_LINE):
                # a zip's lines may come out longer than was asked for
                if not line.endswith(b"\n") or len(line) > _LONGEST_LINE:
                    raise InvalidInput(f"a row of {table} in the archive is cut short or too long")
                row = _parsed(line, f"a row of {table}")
                if not all(isinstance(v, str | int | float | None) for v in row.values()):
                    raise InvalidInput(f"a row of {table} in the archive has nested values")
                yield row

    def blob(self, key: str) -> bytes:
        """The bytes with this SHA-256."""
        with _readable():
            content = self._zip.read(f"blobs/{key}")
        if sha256(content) != key:
            raise InvalidInput(f"blob {key} of the archive has other bytes than its name says")
        return content

    def _check_members(self, packed: int) -> None:
        members = self._zip.infolist()
        names = [member.filename for member in members]
        if strange := [name for name in names if not _NAME.fullmatch(name)][:5]:
            raise InvalidInput(f"an archive has a manifest, tables and blobs; this has {strange}")
        if len(set(names)) < len(names):
            raise InvalidInput("the archive has a member twice")
        for member in members:
            if (most := _largest(member.filename)) is not None and member.file_size > most:
                raise InvalidInput(
                    f"{member.filename} of the archive has {member.file_size} bytes; accepted are "
                    f"{most}"
                )
        check_size(members, packed, "archive")

    def _read_manifest(self) -> Manifest:
        if _MANIFEST not in self._zip.namelist():
            raise InvalidInput("this is no archive of a benchmark, or is cut short: no manifest")
        with _readable():
            text = self._zip.read(_MANIFEST)
        given = _parsed(text, "the manifest")
        if given.get("format") != 1:
            raise InvalidInput(
                f"the archive has format {given.get('format')!r}; this version reads format 1"
            )
        try:
            return Manifest.model_validate(given)
        except ValidationError as error:
            raise InvalidInput(f"the archive's manifest: {explain(error, 'manifest')}") from error


def _member(name: str) -> zipfile.ZipInfo:
    member = zipfile.ZipInfo(name, _EARLIEST)
    member.compress_type = zipfile.ZIP_DEFLATED
    return member


def _largest(name: str) -> int | None:
    """The most bytes that a member may have; None: it is read line by line."""
    if name == _MANIFEST:
        return _LARGEST_MANIFEST
    return _LARGEST_BLOB if name.startswith("blobs/") else None


def _parsed(text: bytes, name: str) -> dict[str, Any]:
    try:
        value = json.loads(text)
    except (ValueError, RecursionError) as error:
        raise InvalidInput(f"{name} in the archive is no JSON: {error}") from error
    if not isinstance(value, dict):
        raise InvalidInput(f"{name} in the archive is no JSON object")
    return cast(dict[str, Any], value)


@contextmanager
def _readable() -> Generator[None]:
    """Raise InvalidInput for a zip that cannot be read."""
    try:
        yield
    except BROKEN as error:
        raise InvalidInput(f"not a readable archive: {error}") from error
