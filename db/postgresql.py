"""PostgreSQL: a database of a server.

backend = Postgresql("postgresql+psycopg://adr@db.example.org/adr")
backend.lock()                          # DatabaseInUse if another service has it
"""

import logging
from collections.abc import Generator
from contextlib import contextmanager
from typing import Any

from sqlalchemy import Connection, ExceptionContext, create_engine, event, make_url
from sqlalchemy.exc import DataError, DBAPIError, OperationalError

from adr_service.errors import AdrError, InvalidInput
from db.backends import BUSY_TIMEOUT_MS, ONE_CONNECTION, without_secrets
from db.errors import DatabaseInUse, DatabaseUnavailable, DiskFull

log = logging.getLogger(__name__)
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


class Postgresql:
    """A database of a PostgreSQL server; the writer's connection holds an advisory lock.

    A service without the lock has no connection to write with, also after the server restarted.
    Both ends notice within a minute that the other is gone.
    """

    _LOCK = 0xAD5  # among the advisory locks of the database
    _LOCK_WAIT_MS = 1_000  # a server needs a moment to see that a connection was closed
    # SQLSTATE disk_full, lock_not_available, read_only_sql_transaction
    _FULL, _NOT_AVAILABLE, _READ_ONLY = "53100", "55P03", "25006"

    def __init__(self, url: str):
        parsed = make_url(url)
        self.name = without_secrets(parsed)
        ours = {name: v for name, v in _CLIENT.items() if name not in parsed.query}
        settings = [f"-c {name}={value}" for name, value in _SERVER.items()]
        given = parsed.query.get("options", ())  # several, if the URL repeats it
        settings += [given] if isinstance(given, str) else given
        arguments: dict[str, Any] = {**ours, "options": " ".join(settings)}
        options: dict[str, Any] = {"pool_pre_ping": True}
        can_write = {**arguments, "target_session_attrs": "read-write"}
        try:
            self.writer = create_engine(url, **options, **ONE_CONNECTION, connect_args=can_write)
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
        """Leave a server that takes no writes: the next connection may meet one that does."""
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
