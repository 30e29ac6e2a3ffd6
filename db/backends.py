"""What SQLite and PostgreSQL each need of their own to have one writer that loses nothing.

backend = backend_of("sqlite:////data/adr.sqlite")     # or postgresql+psycopg://user@host/name
backend.lock()                                         # DatabaseInUse where another service has it
"""

import logging
import sqlite3
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Protocol

from filelock import FileLock, Timeout
from sqlalchemy import URL, Connection, Engine, ExceptionContext, create_engine, event, make_url
from sqlalchemy.exc import ArgumentError, DataError, DBAPIError, OperationalError

from adr_service.errors import AdrError, InvalidInput
from db.errors import DatabaseInUse, DatabaseUnavailable, DiskFull
from db.maintenance import backup

log = logging.getLogger(__name__)
BUSY_TIMEOUT_MS = 5_000  # for other processes, such as a backup, and for other writers of ours
_ACCEPTED = (
    "the database must be an SQLite file, sqlite:///PATH, or in PostgreSQL, "
    "postgresql+psycopg://USER@HOST/NAME"
)
_ONE_CONNECTION: dict[str, Any] = {"pool_size": 1, "max_overflow": 0}

_SERVER = {  # settings of a session in PostgreSQL
    "lock_timeout": BUSY_TIMEOUT_MS,
    "tcp_keepalives_idle": 30,
    "tcp_keepalives_interval": 10,
    "tcp_keepalives_count": 3,
    "timezone": "UTC",
}
_CLIENT = {  # and of our end of it
    "connect_timeout": BUSY_TIMEOUT_MS // 1000,
    "keepalives_idle": 10,
    "keepalives_interval": 5,
    "keepalives_count": 3,
    "tcp_user_timeout": 15_000,
}


class Backend(Protocol):
    """One kind of database."""

    name: str  # of the database, for people; no password in it
    writer: Engine  # of one connection
    reader: Engine  # whose transactions see one moment and cannot write

    def lock(self) -> None:
        """Keep other services away, until `unlock`; DatabaseInUse where one has it."""
        ...

    def unlock(self) -> None: ...

    def keep(self, revision: str) -> None:
        """Keep what there is before its tables are upgraded."""
        ...

    def explain(self, error: DBAPIError) -> AdrError | None:
        """Trouble with the database, and not with what was asked of it, under its own name."""
        ...


def backend_of(url: str) -> Backend:
    """Raises InvalidInput where the service knows no such database."""
    return (_Postgresql if _parsed(url).drivername == "postgresql+psycopg" else _Sqlite)(url)


def file_of(url: str) -> Path:
    """The SQLite file that a URL names."""
    parsed = _parsed(url)
    if parsed.get_backend_name() != "sqlite" or parsed.database in {None, "", ":memory:"}:
        raise InvalidInput(f"{_ACCEPTED}; given {parsed.render_as_string(hide_password=True)!r}")
    return Path(str(parsed.database))


def _parsed(url: str) -> URL:
    try:
        return make_url(url)
    except (ArgumentError, ValueError):  # whose message may have a password
        raise InvalidInput(f"the database's URL cannot be read; {_ACCEPTED}") from None


class _Sqlite:
    """A file, with a lock file beside it.

    The write-ahead log with full synchronisation: what a transaction committed is on disk. The
    writer begins IMMEDIATE, so that it never has to give up half-way.
    """

    # what passes by itself, or once somebody frees the disk
    _PASSING = (
        sqlite3.SQLITE_BUSY,
        sqlite3.SQLITE_LOCKED,
        sqlite3.SQLITE_IOERR,
        sqlite3.SQLITE_CANTOPEN,
    )

    def __init__(self, url: str):
        self._path = file_of(url)
        self.name = str(self._path)
        self._lock = FileLock(f"{self._path}.lock")
        self.writer = self._engine(url, read_only=False)
        self.reader = self._engine(url, read_only=True)

    def lock(self) -> None:
        if not self._path.parent.is_dir():
            raise InvalidInput(f"there is no folder {self._path.parent} for the database")
        try:
            self._lock.acquire(timeout=0)
        except Timeout:
            raise DatabaseInUse(
                f"{self.name} is in use by another service; stop it, or give this one another "
                "--data-dir"
            ) from None

    def unlock(self) -> None:
        self._lock.release()

    def keep(self, revision: str) -> None:
        now = f"{datetime.now(UTC):%Y%m%dT%H%M%S%f}"
        copy = self._path.with_name(f"{self._path.name}.{revision}.{now}.bak")
        backup(self._path, copy)
        log.info("%s was copied to %s", self.name, copy)

    def explain(self, error: DBAPIError) -> AdrError | None:
        code = getattr(error.orig, "sqlite_errorcode", 0) & 0xFF  # extended codes say more
        if code == sqlite3.SQLITE_FULL:
            return DiskFull("the disk that has the database is full; free some space")
        if code in self._PASSING:
            return DatabaseUnavailable(f"the database cannot be used just now: {error.orig}")
        if code == sqlite3.SQLITE_NOTADB:
            return InvalidInput(f"{self.name} cannot be read as a database: {error.orig}")
        return None

    @staticmethod
    def _engine(url: str, *, read_only: bool) -> Engine:
        engine = create_engine(url, **({} if read_only else _ONE_CONNECTION))

        @event.listens_for(engine, "connect")
        def prepare(connection: Any, record: Any) -> None:
            connection.isolation_level = None  # the driver must not begin transactions itself
            pragmas = ["journal_mode=WAL", "synchronous=FULL", "foreign_keys=ON"]
            pragmas.append(f"busy_timeout={BUSY_TIMEOUT_MS}")
            if read_only:
                pragmas.append("query_only=ON")
            for pragma in pragmas:
                connection.execute(f"PRAGMA {pragma}")

        @event.listens_for(engine, "begin")
        def begin(connection: Connection) -> None:
            connection.exec_driver_sql("BEGIN" if read_only else "BEGIN IMMEDIATE")

        return engine


class _Postgresql:
    """A database of a PostgreSQL server; the writer's connection holds an advisory lock.

    Whoever cannot have the lock has no connection to write with, also after the server restarted.
    Both ends notice within a minute that the other is gone without a word.
    """

    _LOCK = 0xAD5  # among the advisory locks of the database
    _LOCK_WAIT_MS = 1_000  # a server needs a moment to see that a connection was closed
    # SQLSTATE disk_full, lock_not_available, read_only_sql_transaction
    _FULL, _NOT_AVAILABLE, _READ_ONLY = "53100", "55P03", "25006"

    def __init__(self, url: str):
        parsed = make_url(url)
        self.name = parsed.render_as_string(hide_password=True)
        ours = {name: v for name, v in _CLIENT.items() if name not in parsed.query}
        settings = [f"-c {name}={value}" for name, value in _SERVER.items()]
        told = " ".join([*settings, str(parsed.query.get("options", ""))])  # the URL's come last
        arguments: dict[str, Any] = {**ours, "options": told}
        options: dict[str, Any] = {"pool_pre_ping": True}
        can_write = {**arguments, "target_session_attrs": "read-write"}
        try:
            self.writer = create_engine(url, **options, **_ONE_CONNECTION, connect_args=can_write)
        except ModuleNotFoundError as error:
            raise InvalidInput(
                f"{self.name} needs psycopg: pip install 'adr-service[postgresql]'"
            ) from error
        self.reader = create_engine(
            url,
            **options,
            connect_args=arguments,
            isolation_level="REPEATABLE READ",
            execution_options={"postgresql_readonly": True},
        )
        event.listen(self.writer, "connect", self._take)
        event.listen(self.writer, "handle_error", self._leave)

    def _take(self, connection: Any, record: Any) -> None:
        wait = f"set local lock_timeout = {self._LOCK_WAIT_MS}"
        try:
            connection.execute(wait)
            connection.execute("select pg_advisory_lock(%s)", (self._LOCK,))
            connection.commit()
        except Exception as error:  # psycopg's, which is not there where SQLite serves
            connection.close()
            if getattr(error, "sqlstate", None) != self._NOT_AVAILABLE:
                raise
            raise DatabaseInUse(
                f"{self.name} is in use by another service, or by a connection of this one that "
                "was cut off; stop the other, or wait a minute"
            ) from None

    def _leave(self, context: ExceptionContext) -> None:
        """A server that takes no writes any more: the next connection may find one that does."""
        if getattr(context.original_exception, "sqlstate", None) == self._READ_ONLY:
            context.is_disconnect = True

    def lock(self) -> None:
        self.writer.connect().close()  # the connection itself stays, in the pool

    def unlock(self) -> None:
        """It went with the writer's connection."""

    def keep(self, revision: str) -> None:
        """Upgrades are one transaction there; copies are the server's business (pg_dump)."""
        log.info("%s is upgraded without a copy: its server's backups are the way back", self.name)

    def explain(self, error: DBAPIError) -> AdrError | None:
        if isinstance(error, DataError):  # too long, too large, a NUL: SQLite would store it
            return InvalidInput(f"the database cannot store this: {error.orig}")
        if not (isinstance(error, OperationalError) or error.connection_invalidated):
            return None
        if getattr(error.orig, "sqlstate", None) == self._FULL:
            return DiskFull("the disk that has the database is full; free some space")
        return DatabaseUnavailable(f"the database cannot be used just now: {error.orig}")
