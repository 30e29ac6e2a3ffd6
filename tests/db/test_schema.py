"""The tables of each revision, and what a file lacks of them."""

from concurrent.futures import ThreadPoolExecutor
from contextlib import closing

import pytest
from alembic import command
from sqlalchemy import create_engine, text

from adr_service.errors import InvalidInput
from db.errors import DatabaseDamaged
from db.schema import alembic_config, clear_leftovers, differences, head, revisions
from db.session import open_database

REVISIONS = sorted(revisions())


@pytest.fixture
def connection():
    """A connection to an empty database in memory."""
    engine = create_engine("sqlite://")
    with engine.connect() as connection:
        yield connection
    engine.dispose()


def upgrade(connection, revision):
    config = alembic_config("sqlite://")
    config.attributes["connection"] = connection
    command.upgrade(config, revision)


def test_the_head_is_the_last_revision():
    assert head() == REVISIONS[-1]


@pytest.mark.parametrize("url", ["sqlite:////a%20b/adr.sqlite", "sqlite:////100%/adr.sqlite"])
def test_a_percent_sign_in_a_path_survives_the_settings(url):
    assert alembic_config(url).get_main_option("sqlalchemy.url") == url


@pytest.mark.parametrize("revision", REVISIONS)
def test_migrations_up_to_a_revision_make_its_tables(connection, revision):
    upgrade(connection, revision)
    assert differences(connection, revision) == []


def test_databases_are_made_in_several_threads_at_once(tmp_path):
    """Two imports of archives at once do this."""

    def make(number):
        with closing(open_database(f"sqlite:///{tmp_path / str(number)}.sqlite")) as made:
            return made.revision()

    with ThreadPoolExecutor(4) as threads:
        assert set(threads.map(make, range(12))) == {head()}


def test_an_empty_database_lacks_nothing_of_no_revision(connection):
    assert differences(connection, None) == []
    missing = differences(connection, head())
    assert "the table runs is missing" in missing
    assert not any("runs lacks" in line for line in missing)


def test_a_missing_column_and_index_are_named(connection):
    upgrade(connection, "head")
    connection.execute(text("create table other (x)"))  # somebody else's
    connection.execute(text("alter table events rename column type to kind"))
    assert differences(connection, head()) == ["the table events lacks type, of its columns"]


def test_a_revision_that_this_version_does_not_know_is_named(connection):
    lines = ["revision 9999 is of a later version of the service: read it with that one"]
    assert differences(connection, "9999") == lines


@pytest.mark.parametrize("revision", REVISIONS[:-1])
def test_empty_tables_of_a_later_revision_are_cleared_away(connection, revision):
    upgrade(connection, revision)
    later = create_engine("sqlite://")
    with later.connect() as ahead:
        upgrade(ahead, "head")
        expected = set(differences(ahead, revision))
    later.dispose()
    for line in expected:
        table = line.removeprefix("the table ").partition(" ")[0]
        connection.execute(text(f"create table {table} (x)"))
    assert set(differences(connection, revision)) == expected
    clear_leftovers(connection, revision)
    assert differences(connection, revision) == []


def test_a_leftover_table_with_rows_is_never_dropped(connection):
    upgrade(connection, "0001")
    connection.execute(text("create table datasets (x)"))
    connection.execute(text("insert into datasets values (1)"))
    with pytest.raises(DatabaseDamaged, match="left rows in datasets; restore the copy"):
        clear_leftovers(connection, "0001")
    assert connection.scalar(text("select count(*) from datasets")) == 1


def test_an_empty_table_of_another_program_is_not_dropped(connection):
    """Its file was named by mistake, and the table has the name of one of ours."""
    connection.execute(text("create table runs (id text, distance_km real)"))
    with pytest.raises(InvalidInput, match="another program: its table runs has a column distance"):
        clear_leftovers(connection, None)
    assert connection.scalar(text("select count(*) from runs")) == 0
    connection.execute(text("drop table runs"))
    connection.execute(text("create table runs (id text, state text)"))  # as of a first start
    clear_leftovers(connection, None)
    assert differences(connection, None) == []
