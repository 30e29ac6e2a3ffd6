"""An archive as a database of its own, with the tables of this version.

    with staged(file, folder) as archived:      # InvalidInput where it is damaged or hostile
        archived.database, archived.manifest

Its rows are put into the tables of the revision that it was written at, which are then upgraded as
any older database is. All of it is on disk, and is removed at the end.
"""

import shutil
from collections.abc import Generator, Iterator
from contextlib import closing, contextmanager
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import IO, Any

from sqlalchemy import Column, Connection, MetaData, Table
from sqlalchemy.exc import IntegrityError

from adr_service.benchmark.archive import ArchiveReader, Manifest
from adr_service.errors import InvalidInput
from db.backends import url_of
from db.errors import DiskFull
from db.models import NUMBER, BenchmarkRow, EventRow, RunRow, StageArtifactRow, StageRow
from db.schema import revisions
from db.session import Database

TABLES = (BenchmarkRow, RunRow, EventRow, StageRow, StageArtifactRow)  # parents first
PREFIX = ".adr-archive-"  # of the temporary folders
_AT_ONCE = 1000  # rows of one statement
_BYTES_AT_ONCE = 16_000_000  # about, of the rows of one statement
# of the content on disk: the database, its log, a copy before it is upgraded, and what is added
_COPIES = 4
_UNREADABLE = (ValueError, LookupError, TypeError, AttributeError, RecursionError)
_LARGEST_FLOAT = 1e300
_LARGEST = 2**31  # of integers, in PostgreSQL


_KINDS = {
    str: "a text",
    int: "an integer below 2**31",
    float: "a number",
    bool: "true or false",
    datetime: "a time with its zone",
}


@dataclass(frozen=True)
class Staged:
    """An archive's rows and bytes in tables."""

    manifest: Manifest
    database: Database


@contextmanager
def staged(file: IO[bytes], folder: Path, floor: float = 0) -> Generator[Staged]:
    """Read an archive into a database in a temporary folder of `folder`.

    Raises DiskFull unless `floor` bytes of the disk stay free meanwhile.
    """
    with ArchiveReader(file) as archive, TemporaryDirectory(prefix=PREFIX, dir=folder) as place:
        _check_tables(archive)
        _check_disk(archive, folder, floor)
        with closing(Database(url_of(Path(place) / "archive.sqlite"))) as database:
            database.upgrade(archive.manifest.revision)
            try:
                with database.write("fill_archive") as session:
                    _insert(session.connection(), archive)
            except IntegrityError as error:
                raise InvalidInput(f"the archive contradicts itself: {error.orig}") from error
            try:
                database.upgrade()
            except _UNREADABLE as error:  # of a migration, by a document
                raise InvalidInput(
                    f"the archive is of revision {archive.manifest.revision}, and its specs cannot "
                    f"be brought to today's: {type(error).__name__}: {error}"
                ) from error
            yield Staged(archive.manifest, database)


def clear(folder: Path) -> None:
    """Remove what services that were killed have left of archives."""
    for left in folder.glob(f"{PREFIX}*"):
        shutil.rmtree(left, ignore_errors=True)


def _check_disk(archive: ArchiveReader, folder: Path, floor: float) -> None:
    free, needed = shutil.disk_usage(folder).free, _COPIES * archive.unpacked
    if needed > free - floor:
        raise DiskFull(
            f"to read the archive takes {needed / 1e6:.0f} MB of the disk for a while; "
            f"{max(0.0, free - floor) / 1e6:.0f} can be used"
        )


def _check_tables(archive: ArchiveReader) -> None:
    manifest, names = archive.manifest, {table.__tablename__ for table in TABLES}
    if manifest.revision not in revisions():
        raise InvalidInput(
            f"a later version of the service wrote the archive ({manifest.adr_service}, tables of "
            f"revision {manifest.revision}): read it with that one"
        )
    if archive.tables != names:
        raise InvalidInput(
            f"the archive has the tables {sorted(archive.tables)}; accepted: {sorted(names)}"
        )


def _insert(connection: Connection, archive: ArchiveReader) -> None:
    artifacts = Table("artifacts", MetaData(), autoload_with=connection)
    for key in archive.blobs:
        content = archive.blob(key)
        row = {"sha256": key, "size": len(content), "content": content}
        connection.execute(artifacts.insert(), [row])
    for name in (table.__tablename__ for table in TABLES):
        table = Table(name, MetaData(), autoload_with=connection, resolve_fks=False)
        for rows in _batches(_checked(row, table) for row in archive.rows(name)):
            connection.execute(table.insert(), rows)


def _checked(row: dict[str, Any], table: Table) -> dict[str, Any]:
    """A row with values of its columns' types."""
    columns = {column.name: column for column in table.columns if column.name != NUMBER}
    if row.keys() != columns.keys():
        raise InvalidInput(
            f"a row of {table.name} in the archive has the columns {sorted(row)}; accepted: "
            f"{sorted(columns)}"
        )
    return {name: _value(row[name], column) for name, column in columns.items()}


def _value(given: Any, column: Column[Any]) -> Any:
    kind = column.type.python_type
    if given is None and column.nullable:
        return None
    if kind is datetime and isinstance(given, str):
        try:
            moment = datetime.fromisoformat(given)
            if moment.tzinfo is not None:
                return moment.astimezone(UTC)
        except (ValueError, OverflowError):
            pass  # refused below
    elif kind is float and isinstance(given, int | float) and abs(given) < _LARGEST_FLOAT:
        return float(given)
    elif isinstance(given, str) and kind is str:
        _check_text(given, column)
        return given
    elif isinstance(given, int) and type(given) is kind and abs(given) < _LARGEST:  # or a bool
        return given
    raise InvalidInput(
        f"{column.table.name}.{column.name} in the archive must be {_KINDS[kind]}; given "
        f"{str(given)[:100]!r}"
    )


def _check_text(given: str, column: Column[Any]) -> None:
    longest = getattr(column.type, "length", None)
    if longest is not None and len(given) > longest:
        raise InvalidInput(
            f"{column.table.name}.{column.name} in the archive has {longest} characters at most; "
            f"given {len(given)}"
        )
    if "\0" in given:
        raise InvalidInput(f"{column.table.name}.{column.name} in the archive has a zero byte")
    try:
        given.encode()
    except UnicodeEncodeError as error:
        raise InvalidInput(f"{column.table.name}.{column.name} in the archive: {error}") from error


def _batches(rows: Iterator[dict[str, Any]]) -> Iterator[list[dict[str, Any]]]:
    batch: list[dict[str, Any]] = []
    size = 0
    for row in rows:
        batch.append(row)
        size += sum(len(value) for value in row.values() if isinstance(value, str))
        if len(batch) == _AT_ONCE or size > _BYTES_AT_ONCE:
            yield batch
            batch, size = [], 0
    if batch:
        yield batch
