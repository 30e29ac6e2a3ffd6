"""URLs of databases."""

import pytest

from adr_service.errors import InvalidInput
from db.session import open_database


@pytest.mark.parametrize("url", ["sqlite://", "sqlite:///:memory:", "mysql://a:secret@b/c"])
def test_other_databases_are_refused(url):
    with pytest.raises(InvalidInput, match="must be an SQLite file") as refused:
        open_database(url)
    assert "secret" not in str(refused.value)
