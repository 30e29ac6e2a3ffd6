"""An archive as a database of its own, with the tables of this version.

    with staged(file, folder) as archived:      # InvalidInput where it is damaged or hostile
        archived.database, archived.manifest

Its rows are put into the tables of the revision that it was written at, which are then upgraded as
any older database is. All of it is on disk, and is removed at the end.
"""

from collections.abc import Generator, Iterator
from contextlib import closing, contextmanager
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import IO, Any

from sqlalchemy import Column, Connection, MetaData, Table
from sqlalchemy.exc import IntegrityError

from adr_service.benchmark.archive import ArchiveReader, Manifest
from adr_service.errors import InvalidInput
from db.models import NUMBER, BenchmarkRow, EventRow, RunRow, StageArtifactRow, StageRow
from db.schema import revisions
from db.session import Database

TABLES = (BenchmarkRow, RunRow, EventRow, StageRow, StageArtifactRow)  # parents first
_AT_ONCE = 1000  # rows of one statement
_LARGEST = 2**63  # of integers


@dataclass(frozen=True)
class Staged:
    """An archive's rows and bytes in tables."""

    manifest: Manifest
    database: Database


@contextmanager
def staged(file: IO[bytes], folder: Path) -> Generator[Staged]:
    """Read an archive into a database in a temporary folder of `folder`."""
    with ArchiveReader(file) as archive, TemporaryDirectory(prefix="archive-", dir=folder) as place:
        _check_tables(archive)
        with closing(Database(f"sqlite:///{Path(place) / 'archive.sqlite'}")) as database:
            database.upgrade(archive.manifest.revision)
            try:
                with database.write("fill_archive") as session:
                    _insert(session.connection(), archive)
            except IntegrityError as error:
                raise InvalidInput(f"the archive contradicts itself: {error.orig}") from error
            database.upgrade()
            yield Staged(archive.manifest, database)


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
        except ValueError:
            moment = datetime.min
        if moment.tzinfo is not None:
            return moment
    elif kind is float and isinstance(given, int | float) and not isinstance(given, bool):
        return float(given)
    elif isinstance(given, str) and kind is str:
        _check_text(given, column)
        return given
    elif isinstance(given, int) and type(given) is kind and abs(given) < _LARGEST:  # or a bool
        return given
    raise InvalidInput(
        f"{column.table.name}.{column.name} in the archive is a {kind.__name__}; given "
        f"{str(given)[:100]!r}"
    )


def _check_text(given: str, column: Column[Any]) -> None:
    longest = getattr(column.type, "length", None)
    if longest is not None and len(given) > longest:
        raise InvalidInput(
            f"{column.table.name}.{column.name} in the archive has {longest} characters at most; "
            f"given {len(given)}"
        )
    try:
        given.encode()
    except UnicodeEncodeError as error:
        raise InvalidInput(f"{column.table.name}.{column.name} in the archive: {error}") from error


def _batches(rows: Iterator[dict[str, Any]]) -> Iterator[list[dict[str, Any]]]:
    batch: list[dict[str, Any]] = []
    for row in rows:
        batch.append(row)
        if len(batch) == _AT_ONCE:
            yield batch
            batch = []
    if batch:
        yield batch
