"""The tables of each revision: made by migrations, compared with what a file has.

    config = alembic_config(url)
    differences(connection, "0005")        # [] where an SQLite file has the tables of a revision
    clear_leftovers(connection, "0003")    # leftovers of an upgrade to a later one

Up to revision 0004, SQLite stored every statement of a migration by itself, so a process that died
in between left tables that made every later start fail. Since then an upgrade is one transaction.
"""

from dataclasses import dataclass
from functools import cache
from pathlib import Path
from threading import RLock

from alembic import command
from alembic.config import Config
from alembic.script import ScriptDirectory
from sqlalchemy import Connection, Inspector, create_engine, inspect, text

from adr_service.errors import InvalidInput
from db.errors import DatabaseDamaged

MIGRATING = RLock()  # held by Alembic's commands, which share globals

_REBUILT = "_alembic_tmp_"  # SQLite's tables are changed by making them anew
_RESTORE = "restore the copy that was made before it (*.bak, beside the database)"


def alembic_config(url: str) -> Config:
    """Alembic's settings for the database at `url`."""
    config = Config()
    config.set_main_option("script_location", str(Path(__file__).parent / "migrations"))
    config.set_main_option("sqlalchemy.url", url.replace("%", "%%"))
    return config


@cache
def head() -> str | None:
    """The revision of this version of the service."""
    return ScriptDirectory.from_config(alembic_config("sqlite://")).get_current_head()


@cache
def revisions() -> frozenset[str]:
    """All revisions that this version of the service knows."""
    scripts = ScriptDirectory.from_config(alembic_config("sqlite://"))
    return frozenset(script.revision for script in scripts.walk_revisions())


@dataclass(frozen=True)
class Schema:
    """Names alone: versions of the libraries write the same tables in other words."""

    tables: frozenset[str]
    columns: frozenset[tuple[str, str]]  # (table, column)
    indexes: frozenset[tuple[str, str]]  # (table, index)


def differences(connection: Connection, revision: str | None) -> list[str]:
    """List what the tables lack of a revision, and tables of later revisions, a line each.

    Tables that no revision has are ignored: they belong to somebody else.
    """
    if revision is not None and revision not in revisions():
        return [f"revision {revision} is of a later version of the service: read it with that one"]
    there, expected = _schema(inspect(connection)), _schema_of(revision)
    known = _schema_of("head")
    # columns and indexes of a missing table are not listed
    lacking = [f"the table {name} is missing" for name in sorted(expected.tables - there.tables)]
    for kind in ("columns", "indexes"):
        missing = getattr(expected, kind) - getattr(there, kind)
        lacking += [
            f"the table {table} lacks {name}, of its {kind}"
            for table, name in sorted(missing)
            if table in there.tables
        ]
    later = there.tables & (known.tables - expected.tables)
    return lacking + [
        f"the table {name} is of a later revision: an upgrade was cut short, and goes on with "
        "`adr db upgrade`"
        for name in sorted(later)
    ]


def clear_leftovers(connection: Connection, revision: str | None) -> None:
    """Drop the leftovers of an upgrade of SQLite that was cut short, in the open transaction.

    No table with rows is dropped: raises DatabaseDamaged with its name. Without a revision, raises
    InvalidInput if a table has a column that ours has in no revision: it is another program's.
    """
    there, expected = _schema(inspect(connection)), _schema_of(revision)
    known = _schema_of("head")
    for table in sorted(table for table in there.tables if table.startswith(_REBUILT)):
        if table.removeprefix(_REBUILT) not in there.tables:
            raise DatabaseDamaged(
                f"an upgrade from revision {revision} was cut short while it rebuilt the table "
                f"{table.removeprefix(_REBUILT)}; {_RESTORE}"
            )
        connection.execute(text(f"drop table {table}"))  # a copy that was not finished
    leftover = there.tables & (known.tables - expected.tables)
    if revision is None and leftover:
        _check_ours(there, leftover)
    for table in sorted(leftover):
        if connection.scalar(text(f"select 1 from {table} limit 1")):  # noqa: S608 - our own names
            raise DatabaseDamaged(
                f"an upgrade from revision {revision} was cut short and left rows in {table}; "
                f"{_RESTORE}"
            )
        connection.execute(text(f"drop table {table}"))
    for table, index in sorted(there.indexes & (known.indexes - expected.indexes)):
        if table not in leftover:
            connection.execute(text(f"drop index {index}"))
    for table, column in sorted(there.columns & (known.columns - expected.columns)):
        if table not in leftover:
            connection.execute(text(f"alter table {table} drop column {column}"))


def _check_ours(there: Schema, leftover: frozenset[str]) -> None:
    """Refuse a table that only has the name of one of ours."""
    ours = frozenset[tuple[str, str]]().union(*(_schema_of(each).columns for each in revisions()))
    for table, column in sorted(there.columns - ours):
        if table in leftover:
            raise InvalidInput(
                f"the database belongs to another program: its table {table} has a column "
                f"{column}, which ours never had; name a file or a database of its own"
            )


@cache
def _schema_of(revision: str | None) -> Schema:
    """The schema that the migrations up to a revision make, in memory."""
    engine = create_engine("sqlite://")
    with engine.connect() as connection:
        if revision is not None:
            config = alembic_config("sqlite://")
            config.attributes["connection"] = connection
            with MIGRATING:
                command.upgrade(config, revision)
        return _schema(inspect(connection))


def _schema(inspector: Inspector) -> Schema:
    tables = frozenset(inspector.get_table_names()) - {"alembic_version"}
    columns = {(table, str(c["name"])) for table in tables for c in inspector.get_columns(table)}
    indexes = {(table, str(i["name"])) for table in tables for i in inspector.get_indexes(table)}
    return Schema(tables, frozenset(columns), frozenset(indexes))
