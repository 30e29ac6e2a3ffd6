"""Looking after a database file. All but `restore` works beside a service, and writes nothing.

check(path)                     # the damage, a line each; [] for a sound file
unfinished(path)                # tables that an unfinished upgrade left over or did not make
backup(path, copy)
restore(path, copy)             # with the database's lock held
"""

import json
import sqlite3
from collections.abc import Generator, Iterator
from contextlib import closing, contextmanager, suppress
from datetime import UTC, datetime
from pathlib import Path

from sqlalchemy import StaticPool, String, create_engine

from adr_service.errors import InvalidInput
from adr_service.json_values import sha256
from adr_service.whole_files import written_whole
from db.errors import DatabaseNewer
from db.models import Base
from db.schema import differences, head, revisions

_DOCUMENTS = {
    *("benchmarks.spec", "runs.spec", "events.body", "target_tasks.document"),
    *("stages.document", "stages.result", "stages.timing", "stages.provenance"),
}


def revision_of(path: Path) -> str | None:
    """Revision of the file's tables; None if it has none yet."""
    with _reader(path) as connection:
        if not connection.execute(
            "select 1 from sqlite_master where name = 'alembic_version'"
        ).fetchone():
            return None
        row = connection.execute("select version_num from alembic_version").fetchone()
    return None if row is None else str(row[0])


def check(path: Path) -> list[str]:
    """List the damage to the file, its references, artifacts, texts and tables, a line each; a file
    without tables is damaged too."""
    damage: list[str] = []
    with _reader(path) as connection:
        connection.text_factory = lambda text: text.decode(errors="replace")
        try:
            lines = [str(line) for (line,) in connection.execute("pragma integrity_check")]
            damage += [] if lines == ["ok"] else lines
            if not connection.execute("select 1 from sqlite_master").fetchone():
                return [*damage, "it has no tables: none were made yet, or it was emptied"]
            for table, row, parent, _ in connection.execute("pragma foreign_key_check"):
                damage.append(f"row {row} of {table} refers to a row of {parent} that is not there")
            for key, content in connection.execute("select sha256, content from artifacts"):
                if sha256(content) != key:
                    damage.append(f"artifact {key} has other bytes than its name says")
            damage += _unreadable(connection)
        except sqlite3.DatabaseError as error:
            damage.append(f"it cannot be read to its end: {error}")
            return damage
    return damage or (unfinished(path) if revision_of(path) == head() else [])


def _unreadable(connection: sqlite3.Connection) -> Iterator[str]:
    """Lines for texts that cannot be decoded, and documents that are no JSON objects."""
    connection.text_factory = bytes
    for table in Base.metadata.sorted_tables:
        present = {name for _, name, *_ in connection.execute(f"pragma table_info({table.name})")}
        for column in table.columns:
            if not isinstance(column.type, String) or column.name.encode() not in present:
                continue  # older databases lack some
            kind = "a JSON object" if f"{table.name}.{column.name}" in _DOCUMENTS else "UTF-8 text"
            cells = connection.execute(f'select rowid, "{column.name}" from {table.name}')  # noqa: S608 - our own names
            for row, content in cells:
                if content is not None and not _is_readable(content, kind):
                    yield f"row {row} of {table.name}: its {column.name} is not {kind}"


def _is_readable(content: bytes, kind: str) -> bool:
    try:
        text = content.decode()
        return kind == "UTF-8 text" or isinstance(json.loads(text), dict)
    except (ValueError, RecursionError):
        return False


def unfinished(path: Path) -> list[str]:
    """List the differences between the tables and those of the file's revision, a line each."""
    with _reader(path) as connection:
        engine = create_engine("sqlite://", creator=lambda: connection, poolclass=StaticPool)
        with engine.connect() as reading:
            return differences(reading, revision_of(path))


def counts(path: Path) -> dict[str, int]:
    """Numbers of rows in the tables that users know."""
    known = ("benchmarks", "runs", "events", "stages", "artifacts", "datasets")
    with _reader(path) as connection:
        there = {name for (name,) in connection.execute("select name from sqlite_master")}
        return {
            table: int(connection.execute(f"select count(*) from {table}").fetchone()[0])  # noqa: S608 - names from `known`
            for table in known
            if table in there  # older databases lack some
        }


def backup(path: Path, copy: Path) -> None:
    """Copy the file as it is at one moment; the copy is complete or is not there.

    Raises InvalidInput if `copy` exists or cannot be written.
    """
    if copy.exists():
        raise InvalidInput(f"{copy} is there already; a backup overwrites nothing")
    try:
        with written_whole(copy, mode=0o600) as part:  # it has robots' leases
            _copy(path, part)
    except (sqlite3.Error, OSError) as error:
        raise InvalidInput(f"{path} could not be copied to {copy}: {error}") from error


def _copy(path: Path, copy: Path) -> None:
    """Copy a database with what its log holds into an empty file."""
    with _reader(path) as connection, closing(sqlite3.connect(copy)) as target:
        connection.backup(target)
        target.execute("pragma journal_mode = delete")  # so that it can be read anywhere


def restore(path: Path, copy: Path) -> Path | None:
    """Put a backup in the place of the database, which must be locked.

    Return the path beside it where the old file is kept; None if there was none. Raises
    InvalidInput if the backup is damaged or cannot be copied, and DatabaseNewer if a later version
    of the service has written it.
    """
    if wrong := check(copy):
        raise InvalidInput("\n".join([f"{copy} is damaged itself, and was not restored", *wrong]))
    if (revision := revision_of(copy)) not in {None, *revisions()}:
        raise DatabaseNewer(
            f"{copy} has tables of revision {revision}, which this version does not know (its own "
            f"is {head()}), and was not restored; restore it with the version of the service that "
            "wrote it"
        )
    aside = path.with_name(f"{path.name}.{datetime.now(UTC):%Y%m%dT%H%M%S%f}.replaced")
    try:
        with written_whole(path, mode=0o600) as part:
            _copy(copy, part)
            _empty_log(path)
            if path.exists() and path.stat().st_size:
                aside.hardlink_to(path)  # so that at no moment there is no database
            for suffix in ("-wal", "-shm"):
                file = path.with_name(path.name + suffix)
                if file.exists():
                    file.replace(aside.with_name(aside.name + suffix))
    except (sqlite3.Error, OSError) as error:
        raise InvalidInput(f"{copy} could not be copied to {path}: {error}") from error
    return aside if aside.exists() else None


def _empty_log(path: Path) -> None:
    """Write what the log of a sound database holds into it, so that it is whole without its log."""
    with suppress(sqlite3.Error), closing(sqlite3.connect(path)) as connection:
        connection.execute("pragma wal_checkpoint(truncate)")


@contextmanager
def _reader(path: Path) -> Generator[sqlite3.Connection]:
    if not path.exists():
        raise InvalidInput(f"there is no database {path}; is it in another --data-dir?")
    with closing(_opened(path)) as connection:
        yield connection


def _opened(path: Path) -> sqlite3.Connection:
    """A connection that reads; also of a file in a folder where nothing can be written."""
    address = f"{path.absolute().as_uri()}?mode=ro"
    log_file = path.with_name(f"{path.name}-wal")
    has_log = log_file.exists() and log_file.stat().st_size > 0
    try:
        return _readable(address)
    except sqlite3.DatabaseError as error:
        if getattr(error, "sqlite_errorname", "").startswith("SQLITE_READONLY") and not has_log:
            return sqlite3.connect(f"{address}&immutable=1", uri=True)
        raise InvalidInput(f"{path} cannot be read as a database: {error}") from error


def _readable(address: str) -> sqlite3.Connection:
    """A connection that has read something; raises sqlite3.DatabaseError."""
    connection = sqlite3.connect(address, uri=True)
    try:
        connection.execute("pragma schema_version")
    except sqlite3.DatabaseError:
        connection.close()
        raise
    return connection
