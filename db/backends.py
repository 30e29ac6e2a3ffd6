"""What SQLite and PostgreSQL each need of their own to have one writer that loses nothing.

backend = backend_of("sqlite:////data/adr.sqlite")     # or postgresql+psycopg://user@host/name
backend.lock()                                         # DatabaseInUse where another service has it
"""

import fcntl
import logging
import os
import shutil
import sqlite3
import stat
from collections.abc import Generator
from contextlib import AbstractContextManager, contextmanager
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Protocol

from sqlalchemy import (
    URL,
    Connection,
    Engine,
    ExceptionContext,
    create_engine,
    event,
    make_url,
    text,
)
from sqlalchemy.exc import ArgumentError, DataError, DBAPIError, OperationalError

from adr_service.errors import AdrError, InvalidInput
from db.errors import (
    DatabaseDamaged,
    DatabaseGone,
    DatabaseInUse,
    DatabaseUnavailable,
    DiskFull,
)
from db.maintenance import backup
from db.schema import clear_leftovers

log = logging.getLogger(__name__)
BUSY_TIMEOUT_MS = 5_000  # for other processes, such as a backup, and for other writers of ours
_ACCEPTED = (
    "the database must be an SQLite file, sqlite:///PATH, or in PostgreSQL, "
    "postgresql+psycopg://USER@HOST/NAME"
)
_ONE_CONNECTION: dict[str, Any] = {"pool_size": 1, "max_overflow": 0}
_INCREMENTAL = 2  # SQLite's auto_vacuum that gives pages back when it is asked to
_PAGES_AT_ONCE = 2_000  # of 4 kB, given back in one transaction
_LONGEST_LOG = 64_000_000  # bytes of the write-ahead log that are kept for reuse

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

    def check_in_place(self) -> None:
        """Raise DatabaseGone if the database's files were deleted or replaced."""
        ...

    def keep(self, revision: str) -> AbstractContextManager[None]:
        """Keep a copy of what there is while its tables are upgraded, and after."""
        ...

    def migrating(self) -> AbstractContextManager[Connection]:
        """A transaction of the writer that may change tables: all of it is stored, or nothing."""
        ...

    def repair(self, connection: Connection, revision: str | None) -> None:
        """Clear away what upgrades of earlier versions left behind; inside `migrating`."""
        ...

    def make_shrinkable(self) -> None:
        """Let the database give disk space back, where it was made without that."""
        ...

    def reclaim(self, connection: Connection) -> bool:
        """Give a portion of free space back to the disk; False where it was all."""
        ...

    def explain(self, error: DBAPIError) -> AdrError | None:
        """Trouble with the database, and not with what was asked of it, under its own name."""
        ...


def backend_of(url: str) -> Backend:
    """Raises InvalidInput where the service knows no such database."""
    return (_Postgresql if _parsed(url).drivername == "postgresql+psycopg" else _Sqlite)(url)


def check_log(url: str) -> None:
    """Refuse an SQLite file that is not there although its write-ahead log is."""
    if _parsed(url).get_backend_name() != "sqlite":
        return
    path = file_of(url)
    log_file = path.with_name(f"{path.name}-wal")
    if not path.exists() and log_file.exists():
        raise InvalidInput(
            f"{path} is not there, but its log is ({log_file.name}): a new database would begin "
            "empty, and what the log has would be lost. Stop the service that may still have them "
            "open, then put the database back, restore a backup (`adr db restore COPY`), or remove "
            "the log"
        )


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
        self._log_file = self._path.with_name(f"{self._path.name}-wal")
        self._file = -1  # descriptor that holds the lock
        self._log: int | None = None  # inode of the write-ahead log, once it was seen
        self.writer = self._engine(url, read_only=False)
        self.reader = self._engine(url, read_only=True)

    def lock(self) -> None:
        """The lock is on the database file itself, and cannot be deleted beside it.

        The descriptor stays open until `unlock`: closing one drops SQLite's own locks.
        """
        if not self._path.parent.is_dir():
            raise InvalidInput(f"there is no folder {self._path.parent} for the database")
        try:
            # SQLite gives its other files the mode of this one
            self._file = os.open(self._path, os.O_RDWR | os.O_CREAT, 0o600)
        except OSError as error:
            raise InvalidInput(
                f"the database {self.name} cannot be written: {error.strerror}"
            ) from error
        try:
            fcntl.flock(self._file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            self.unlock()
            raise DatabaseInUse(
                f"{self.name} is in use by another service; stop it, or give this one another "
                "--data-dir"
            ) from None
        mode = stat.S_IMODE(os.fstat(self._file).st_mode)
        if mode & 0o077 and stat.S_IMODE(self._path.parent.stat().st_mode) & 0o011:
            log.warning("%s is open to others (mode %o): chmod 600 it", self.name, mode)

    def unlock(self) -> None:
        if self._file >= 0:
            os.close(self._file)
        self._file = -1

    def check_in_place(self) -> None:
        """The file and its write-ahead log must be those that were opened."""
        log_file = self._log_file
        try:
            opened, there = os.fstat(self._file), os.stat(self._path)
            if not os.path.samestat(opened, there):
                raise FileNotFoundError(self._path)
            if self._log is None:
                self._log = os.stat(log_file).st_ino if log_file.exists() else None
            elif os.stat(log_file).st_ino != self._log:
                raise FileNotFoundError(log_file)
        except FileNotFoundError as error:
            raise DatabaseGone(
                f"{error.filename or error} was deleted or replaced while the service had it open, "
                "so nothing can be stored any more: stop the service and restore a backup "
                "(`adr db restore`)"
            ) from error

    @contextmanager
    def keep(self, revision: str) -> Generator[None]:
        # of upgrades that are killed again and again, one copy stays
        copy = self._path.with_name(f"{self._path.name}.{revision}.upgrading.bak")
        copy.unlink(missing_ok=True)
        backup(self._path, copy)
        try:
            yield
        except BaseException:
            copy.unlink()  # the file is as it was
            raise
        now = f"{datetime.now(UTC):%Y%m%dT%H%M%S%f}"
        kept = copy.rename(self._path.with_name(f"{self._path.name}.{revision}.{now}.bak"))
        log.info("%s was copied to %s", self.name, kept)

    @contextmanager
    def migrating(self) -> Generator[Connection]:
        with self.writer.connect() as connection:
            driver = connection.connection.cursor()
            # to change some tables is to delete and make them again, which would take along the
            # rows that refer to them
            driver.execute("PRAGMA foreign_keys=OFF")
            try:
                with connection.begin():
                    yield connection
            finally:
                driver.execute("PRAGMA foreign_keys=ON")

    def repair(self, connection: Connection, revision: str | None) -> None:
        clear_leftovers(connection, revision)

    def make_shrinkable(self) -> None:
        with self.writer.connect() as connection:
            driver = connection.connection.cursor()
            if driver.execute("PRAGMA auto_vacuum").fetchone() == (_INCREMENTAL,):
                return
            needed, free = 2 * self._path.stat().st_size, shutil.disk_usage(self._path.parent).free
            if needed > free:
                log.warning(
                    "deleting will not give disk space back: to rewrite %s for that takes %.0f MB, "
                    "and %.0f are free; the next start tries again",
                    self.name,
                    needed / 1e6,
                    free / 1e6,
                )
                return
            log.info("%s is rewritten once, so that deleting gives disk space back", self.name)
            try:
                driver.execute(f"PRAGMA auto_vacuum={_INCREMENTAL}")
                driver.execute("VACUUM")
            except sqlite3.DatabaseError as error:
                log.warning(
                    "%s cannot be rewritten now (%s): deleting will not give disk space back; the "
                    "next start tries again",
                    self.name,
                    error,
                )

    def reclaim(self, connection: Connection) -> bool:
        free = int(connection.scalar(text("PRAGMA freelist_count")) or 0)
        for _ in range(min(free, _PAGES_AT_ONCE)):
            # of several pages, the driver would take the first alone
            connection.exec_driver_sql("PRAGMA incremental_vacuum(1)")
        left = int(connection.scalar(text("PRAGMA freelist_count")) or 0)
        return 0 < left < free  # a file that could not be rewritten gives nothing back

    def explain(self, error: DBAPIError) -> AdrError | None:
        code = getattr(error.orig, "sqlite_errorcode", 0) & 0xFF  # extended codes say more
        if code == sqlite3.SQLITE_FULL:
            return DiskFull("the disk that has the database is full; free some space")
        if code in self._PASSING:
            return DatabaseUnavailable(f"the database cannot be used just now: {error.orig}")
        if code == sqlite3.SQLITE_NOTADB:
            return InvalidInput(f"{self.name} cannot be read as a database: {error.orig}")
        if code == sqlite3.SQLITE_CORRUPT or "decode" in str(error.orig):
            return DatabaseDamaged(
                f"{self.name} is damaged ({error.orig}): `adr db check` says where, and "
                "`adr db restore` puts a backup in its place"
            )
        return None

    @staticmethod
    def _engine(url: str, *, read_only: bool) -> Engine:
        engine = create_engine(url, **({} if read_only else _ONE_CONNECTION))

        @event.listens_for(engine, "connect")
        def prepare(connection: Any, record: Any) -> None:
            connection.isolation_level = None  # the driver must not begin transactions itself
            pragmas = [f"auto_vacuum={_INCREMENTAL}"]  # counts before the first table alone
            pragmas += ["journal_mode=WAL", "synchronous=FULL", "foreign_keys=ON"]
            pragmas += [f"busy_timeout={BUSY_TIMEOUT_MS}", f"journal_size_limit={_LONGEST_LOG}"]
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

    def check_in_place(self) -> None:
        """A server does not lose its files unnoticed."""

    @contextmanager
    def keep(self, revision: str) -> Generator[None]:
        """Copies are the server's business (pg_dump)."""
        log.info("%s is upgraded without a copy: its server's backups are the way back", self.name)
        yield

    @contextmanager
    def migrating(self) -> Generator[Connection]:
        with self.writer.begin() as connection:
            yield connection

    def repair(self, connection: Connection, revision: str | None) -> None:
        """Its upgrades have been one transaction always."""

    def make_shrinkable(self) -> None:
        """The server's autovacuum does that."""

    def reclaim(self, connection: Connection) -> bool:
        """The server's autovacuum does that."""
        return False

    def explain(self, error: DBAPIError) -> AdrError | None:
        if isinstance(error, DataError):  # too long, too large, a NUL: SQLite would store it
            return InvalidInput(f"the database cannot store this: {error.orig}")
        if not (isinstance(error, OperationalError) or error.connection_invalidated):
            return None
        if getattr(error.orig, "sqlstate", None) == self._FULL:
            return DiskFull("the disk that has the database is full; free some space")
        return DatabaseUnavailable(f"the database cannot be used just now: {error.orig}")
