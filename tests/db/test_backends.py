"""URLs of databases: the file that one names, and refusals without a password."""

from pathlib import Path

import pytest

from adr_service.errors import InvalidInput
from db.backends import file_of, parse_url, without_secrets

NO_FILE = ["sqlite://", "sqlite:///:memory:", "postgresql+psycopg://a:secret@host/adr"]


@pytest.mark.parametrize("path", ["adr.sqlite", "/data/adr.sqlite", "/a b/100%.sqlite"])
def test_a_url_names_its_file(path):
    assert file_of(f"sqlite:///{path}") == Path(path)


@pytest.mark.parametrize("url", NO_FILE)
def test_a_url_without_a_file_is_refused_with_the_accepted_forms(url):
    with pytest.raises(InvalidInput, match="must be an SQLite file, sqlite:///PATH") as refused:
        file_of(url)
    assert "secret" not in str(refused.value)


@pytest.mark.parametrize(
    "url", ["postgresql+psycopg://me:secret@host/adr", "postgresql://me@host/adr?password=secret"]
)
def test_the_name_of_a_database_has_no_password(url):
    shown = without_secrets(parse_url(url))
    assert "secret" not in shown
    assert "me" in shown
    assert shown.endswith("@host/adr")


@pytest.mark.parametrize("url", ["", "adr.sqlite", "postgresql+psycopg://me:secret@[::1/adr"])
def test_an_unreadable_url_is_refused_without_its_password(url):
    with pytest.raises(InvalidInput, match="the database's URL cannot be read") as refused:
        parse_url(url)
    assert "secret" not in str(refused.value)
    assert refused.value.__cause__ is None
