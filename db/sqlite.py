"""SQLite: a database in a file.

backend = Sqlite("sqlite:////data/adr.sqlite")
backend.lock()                          # DatabaseInUse if another service has it
"""

import fcntl
import logging
import os
import shutil
import sqlite3
import stat
from collections.abc import Generator
from contextlib import contextmanager
from datetime import UTC, datetime
from typing import Any

from sqlalchemy import Connection, Engine, create_engine, event, text
from sqlalchemy.exc import DBAPIError

from adr_service.errors import AdrError, InvalidInput
from db.backends import BUSY_TIMEOUT_MS, ONE_CONNECTION, file_of, parse_url
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
_INCREMENTAL = 2  # SQLite's auto_vacuum that gives pages back when it is asked to
_PAGES_AT_ONCE = 2_000  # of 4 kB, given back in one transaction
_LONGEST_LOG = 64_000_000  # bytes of the write-ahead log that are kept for reuse


def check_log(url: str) -> None:
    """Raise InvalidInput if an SQLite file is not there although its write-ahead log is."""
    if parse_url(url).get_backend_name() != "sqlite":
        return
    path = file_of(url)
    log_file = path.with_name(f"{path.name}-wal")
    if not path.exists() and log_file.exists() and log_file.stat().st_size:
        raise InvalidInput(
            f"{path} is not there, but its log is ({log_file.name}): a new database would begin "
            "empty, and what the log has would be lost. Stop the service that may still have them "
            "open, then put the database back, restore a backup (`adr db restore COPY`), or remove "
            "the log"
        )


class Sqlite:
    """A file, which the service locks itself.

    It has a write-ahead log with full synchronisation: a committed transaction is on disk. The
    writer begins IMMEDIATE, so that it never has to give up half-way.
    """

    # errors that pass by themselves, or once a user frees the disk
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
        """Lock the database file itself; a lock file beside it could be deleted.

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
        """Raise DatabaseGone if the file or its log is not the one that was opened."""
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
            # SQLite changes some tables by making them anew, which would delete the rows that
            # refer to them
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
            # asked for several pages, the driver would give back the first alone
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
        engine = create_engine(url, **({} if read_only else ONE_CONNECTION))

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
