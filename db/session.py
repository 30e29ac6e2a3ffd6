"""One database, one writer.

SQLite's write-ahead log with full synchronisation: what a transaction committed is on disk.
Writes go through one connection that begins IMMEDIATE, reads through connections that cannot
write. A lock file keeps a second service away from an SQLite file.
"""

import logging
import sqlite3
from collections.abc import Generator
from contextlib import contextmanager
from datetime import UTC, datetime
from pathlib import Path
from threading import RLock
from typing import Any

from alembic import command
from alembic.config import Config
from alembic.script import ScriptDirectory
from filelock import FileLock, Timeout
from sqlalchemy import Connection, Engine, create_engine, event, make_url
from sqlalchemy.exc import OperationalError
from sqlalchemy.orm import Session

from adr_service.errors import AdrError, InvalidInput
from db.failpoints import failpoint
from db.maintenance import backup, revision_of

log = logging.getLogger(__name__)
RETRY_S = 1.0  # after which what was DatabaseUnavailable is worth another try
CHUNK = 10_000  # of a query's variables, of which SQLite has 32,766
_BUSY_TIMEOUT_MS = 5_000  # for other processes, such as a backup, and for other writers of ours
# what passes by itself, or once somebody frees the disk
_PASSING = (
    sqlite3.SQLITE_BUSY,
    sqlite3.SQLITE_LOCKED,
    sqlite3.SQLITE_IOERR,
    sqlite3.SQLITE_CANTOPEN,
)


class DatabaseInUse(AdrError):
    """Another service holds the database."""

    code = "database_in_use"


class DatabaseNewer(AdrError):
    """A later version of the service has written the database."""

    code = "database_newer"


class DatabaseUnavailable(AdrError):
    """The database cannot be used just now; what was asked for may be asked for again."""

    code = "database_unavailable"


class DiskFull(DatabaseUnavailable):
    """Nothing can be stored before somebody frees the disk."""

    code = "disk_full"


class Database:
    """Sessions on one database. Open it once, in the process that owns it.

    Both kinds raise DatabaseUnavailable where another process holds the file for longer than
    seconds, or the disk fails or is full; nothing of the transaction is stored then.
    """

    def __init__(self, url: str):
        self.url = url
        self._write_lock = RLock()
        self._file_lock = _lock_file(url)
        self._writer = _engine(url, read_only=False)
        self._reader = _engine(url, read_only=True)

    @contextmanager
    def write(self, name: str) -> Generator[Session]:
        """A transaction that commits when the block ends, and rolls back when it raises.

        `name` tells it apart from others, for the tests that let the service die in it.
        """
        with self._turn(), _translated(), Session(self._writer) as session, session.begin():
            yield session
            failpoint(f"{name}:before")
        failpoint(f"{name}:after")

    @contextmanager
    def _turn(self) -> Generator[None]:
        if not self._write_lock.acquire(timeout=_BUSY_TIMEOUT_MS / 1000):
            raise DatabaseUnavailable("too much waits to be written to the database just now")
        try:
            yield
        finally:
            self._write_lock.release()

    @contextmanager
    def read(self) -> Generator[Session]:
        with _translated(), Session(self._reader) as session:
            yield session

    def close(self) -> None:
        self._reader.dispose()
        self._writer.dispose()
        self._file_lock.release()


def open_database(url: str) -> Database:
    """The database at `url`, created or upgraded to the present tables, and locked.

    Before an upgrade it is copied to a file beside it. Raises DatabaseNewer where a later version
    of the service has written it.
    """
    database = Database(url)
    try:
        _upgrade(url)
    except BaseException:
        database.close()
        raise
    return database


def _upgrade(url: str) -> None:
    path, config = file_of(url), alembic_config(url)
    scripts = ScriptDirectory.from_config(config)
    now, head = revision_of(path) if path.exists() else None, scripts.get_current_head()
    if now == head:
        return
    if now is not None:
        if now not in {script.revision for script in scripts.walk_revisions()}:
            raise DatabaseNewer(
                f"{path} has tables of revision {now}, which this version does not know (its own "
                f"is {head}); start the version of the service that wrote it, or restore a backup"
            )
        copy = path.with_name(f"{path.name}.{now}.{datetime.now(UTC):%Y%m%dT%H%M%S%f}.bak")
        backup(path, copy)
        log.info("upgrading %s from revision %s to %s; it was copied to %s", path, now, head, copy)
    command.upgrade(config, "head")


def alembic_config(url: str) -> Config:
    config = Config()
    config.set_main_option("script_location", str(Path(__file__).parent / "migrations"))
    config.set_main_option("sqlalchemy.url", url.replace("%", "%%"))
    return config


@contextmanager
def _translated() -> Generator[None]:
    """Trouble with the file, and not with what was asked of it, under a name of its own."""
    try:
        yield
    except OperationalError as error:
        code = getattr(error.orig, "sqlite_errorcode", 0) & 0xFF  # extended codes say more
        if code == sqlite3.SQLITE_FULL:
            raise DiskFull("the disk that has the database is full; free some space") from error
        if code in _PASSING:
            raise DatabaseUnavailable(
                f"the database cannot be used just now: {error.orig}"
            ) from error
        raise


def file_of(url: str) -> Path:
    """The SQLite file that a URL names."""
    parsed = make_url(url)
    if parsed.get_backend_name() != "sqlite" or parsed.database in {None, "", ":memory:"}:
        raise InvalidInput(f"the database must be an SQLite file, sqlite:///PATH; given {url!r}")
    return Path(str(parsed.database))


def _lock_file(url: str) -> FileLock:
    path = file_of(url)
    path.parent.mkdir(parents=True, exist_ok=True, mode=0o700)
    lock = FileLock(f"{path}.lock")
    try:
        lock.acquire(timeout=0)
    except Timeout:
        raise DatabaseInUse(
            f"{path} is in use by another service; stop it, or give this one another --data-dir"
        ) from None
    return lock


def _engine(url: str, *, read_only: bool) -> Engine:
    engine = create_engine(url, **({} if read_only else {"pool_size": 1, "max_overflow": 0}))

    @event.listens_for(engine, "connect")
    def prepare(connection: Any, record: Any) -> None:
        connection.isolation_level = None  # the driver must not begin transactions itself
        pragmas = ["journal_mode=WAL", "synchronous=FULL", "foreign_keys=ON"]
        pragmas.append(f"busy_timeout={_BUSY_TIMEOUT_MS}")
        if read_only:
            pragmas.append("query_only=ON")
        for pragma in pragmas:
            connection.execute(f"PRAGMA {pragma}")

    @event.listens_for(engine, "begin")
    def begin(connection: Connection) -> None:
        connection.exec_driver_sql("BEGIN" if read_only else "BEGIN IMMEDIATE")

    return engine
