"""One database, one writer: sessions, transactions, and the upgrade of its tables.

database = open_database("sqlite:////data/adr.sqlite")
with database.write("create_run") as session: …
with database.read() as session: …
"""

import logging
from collections.abc import Generator, Iterator, Sequence
from contextlib import contextmanager
from threading import RLock
from typing import Any, TypeVar

from alembic import command
from alembic.config import Config
from alembic.runtime.migration import MigrationContext, MigrationInfo
from sqlalchemy.exc import DBAPIError
from sqlalchemy.exc import TimeoutError as PoolTimeout
from sqlalchemy.orm import Session

from db.backends import BUSY_TIMEOUT_MS, Backend, parse_url
from db.errors import DatabaseDamaged, DatabaseNewer, DatabaseUnavailable
from db.failpoints import failpoint
from db.postgresql import Postgresql
from db.schema import MIGRATING, alembic_config, head, revisions
from db.sqlite import Sqlite, check_log

T = TypeVar("T")
log = logging.getLogger(__name__)
RETRY_S = 1.0  # after which a request that met DatabaseUnavailable is worth another try
CHUNK = 10_000  # variables of one query; SQLite allows 32,766


class Database:
    """Sessions on one database. Open it once, in the process that owns it.

    Both kinds of session raise DatabaseUnavailable if another process holds the database for longer
    than seconds, the disk fails or is full, or the server is gone. Nothing of the transaction is
    stored then; but if a server went away before it could answer a commit, all of it may be.
    """

    def __init__(self, url: str):
        self.url = url
        self._backend = backend_of(url)
        self._write_lock = RLock()
        with self._translated():
            self._backend.lock()

    @contextmanager
    def write(self, name: str) -> Generator[Session]:
        """A transaction that commits when the block ends, and rolls back when it raises.

        `name` tells it apart from others, for the tests that let the service die in it.
        """
        session = Session(self._backend.writer)
        with self._turn(), self._translated(), session, session.begin():
            self._backend.check_in_place()
            yield session
            failpoint(f"{name}:before")
        failpoint(f"{name}:after")

    @contextmanager
    def _turn(self) -> Generator[None]:
        if not self._write_lock.acquire(timeout=BUSY_TIMEOUT_MS / 1000):
            raise DatabaseUnavailable("too much waits to be written to the database just now")
        try:
            yield
        finally:
            self._write_lock.release()

    @contextmanager
    def read(self) -> Generator[Session]:
        """A transaction that sees one moment and cannot write."""
        with self._translated(), Session(self._backend.reader) as session:
            yield session

    @contextmanager
    def _translated(self) -> Generator[None]:
        try:
            yield
        except DBAPIError as error:
            if (explained := self._backend.explain(error)) is None:
                raise
            raise explained from error
        except UnicodeDecodeError as error:  # bytes that no constraint lets in
            raise DatabaseDamaged(
                f"the database is damaged ({error}): `adr db check` says where, and `adr db "
                "restore` puts a backup in its place"
            ) from error
        except PoolTimeout as error:
            raise DatabaseUnavailable("too much is read from the database just now") from error

    def reclaim(self) -> bool:
        """Give a portion of freed space back to the disk; False if no space is left to give."""
        with self.write("reclaim") as session:
            return self._backend.reclaim(session.connection())

    def revision(self) -> str | None:
        """Revision of the tables; None if there are none yet."""
        with self.read() as session:
            return MigrationContext.configure(session.connection()).get_current_revision()

    def upgrade(self, to: str | None = None) -> None:
        """Bring the tables to a revision, by default to this version's, in one transaction.

        Raises DatabaseNewer if they are ahead.
        """
        config = alembic_config(self.url)
        now, newest = self.revision(), to or head()
        if now != newest:
            name = self._backend.name
            if now is None:
                self._migrate(config, now, newest)
            elif now in revisions():
                log.info("upgrading %s from revision %s to %s", name, now, newest)
                with self._backend.keep(now):
                    self._migrate(config, now, newest)
            else:
                raise DatabaseNewer(
                    f"{name} has tables of revision {now}, which this version does not know (its "
                    f"own is {newest}); start the version of the service that wrote it, or restore "
                    "a backup"
                )
        self._backend.make_shrinkable()

    def _migrate(self, config: Config, now: str | None, to: str | None) -> None:
        with self._translated(), self._backend.migrating() as connection:
            self._backend.repair(connection, now)
            config.attributes["connection"] = connection
            config.attributes["on_version_apply"] = _pass_migration
            with MIGRATING:
                command.upgrade(config, to or "head")
            failpoint("upgrade:before")
        failpoint("upgrade:after")

    def close(self) -> None:
        """Close all connections, and let another service have the database."""
        self._backend.reader.dispose()
        self._backend.writer.dispose()
        self._backend.unlock()


def _pass_migration(*, step: MigrationInfo, **_: Any) -> None:
    failpoint(f"migration_{step.up_revision_id}")


def open_database(url: str) -> Database:
    """The database at `url`, created or upgraded to the present tables, and locked.

    Before an upgrade an SQLite file is copied to another beside it. Raises DatabaseNewer if a
    later version of the service has written it.
    """
    check_log(url)
    database = Database(url)
    try:
        database.upgrade()
    except BaseException:
        database.close()
        raise
    return database


def backend_of(url: str) -> Backend:
    """The kind of database that a URL names. Raises InvalidInput for other kinds."""
    if parse_url(url).drivername == "postgresql+psycopg":
        return Postgresql(url)
    return Sqlite(url)


def parts(items: Sequence[T], length: int) -> Iterator[Sequence[T]]:
    """A sequence in parts of at most this length, in order."""
    return (items[first : first + length] for first in range(0, len(items), length))
