"""Kinds of database: what each of them must do to have one writer that loses nothing.

`db.sqlite` and `db.postgresql` are the two that there are.
"""

from contextlib import AbstractContextManager
from pathlib import Path
from typing import Any, Protocol

from sqlalchemy import URL, Connection, Engine, make_url
from sqlalchemy.exc import ArgumentError, DBAPIError

from adr_service.errors import AdrError, InvalidInput

BUSY_TIMEOUT_MS = 5_000  # for other processes, such as a backup, and for other writers of ours
ONE_CONNECTION: dict[str, Any] = {"pool_size": 1, "max_overflow": 0}
ACCEPTED = (
    "the database must be an SQLite file, sqlite:///PATH, or in PostgreSQL, "
    "postgresql+psycopg://USER@HOST/NAME"
)


class Backend(Protocol):
    """One kind of database."""

    name: str  # of the database, for people; without its password
    writer: Engine  # has one connection
    reader: Engine  # its transactions see one moment and cannot write

    def lock(self) -> None:
        """Keep other services away until `unlock`; DatabaseInUse if one has the lock."""
        ...

    def unlock(self) -> None:
        """Let other services have the database."""
        ...

    def check_in_place(self) -> None:
        """Raise DatabaseGone if the database's files were deleted or replaced."""
        ...

    def keep(self, revision: str) -> AbstractContextManager[None]:
        """Keep a copy of the database while its tables are upgraded, and after."""
        ...

    def migrating(self) -> AbstractContextManager[Connection]:
        """A transaction of the writer that may change tables; it is stored whole or not at all."""
        ...

    def repair(self, connection: Connection, revision: str | None) -> None:
        """Clear away leftovers of upgrades by earlier versions; inside `migrating`."""
        ...

    def make_shrinkable(self) -> None:
        """Let the database give disk space back, if it was made without that."""
        ...

    def reclaim(self, connection: Connection) -> bool:
        """Give a portion of free space back to the disk; False if no space is left to give."""
        ...

    def explain(self, error: DBAPIError) -> AdrError | None:
        """The error that says what is wrong with the database; None for a defect of ours."""
        ...


def file_of(url: str) -> Path:
    """The SQLite file that a URL names. Raises InvalidInput if it names none."""
    parsed = parse_url(url)
    if parsed.get_backend_name() != "sqlite" or parsed.database in {None, "", ":memory:"}:
        raise InvalidInput(f"{ACCEPTED}; given {without_secrets(parsed)!r}")
    return Path(str(parsed.database))


def without_secrets(url: URL) -> str:
    """The text of a URL without what may be its password, or lead to it."""
    return url.set(query={}).render_as_string(hide_password=True)


def url_of(file: Path) -> str:
    """The URL of an SQLite file, whatever characters its path has."""
    return URL.create("sqlite", database=str(file)).render_as_string()


def parse_url(url: str) -> URL:
    """Parse a database's URL. Raises InvalidInput without repeating its password."""
    try:
        return make_url(url)
    except (ArgumentError, ValueError):  # whose message may have a password
        raise InvalidInput(f"the database's URL cannot be read; {ACCEPTED}") from None
