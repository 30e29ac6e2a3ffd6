"""A service of one's own, beside the one that variables name."""

import pytest

from api.cli.own_service import ServiceDidNotStart, own_service


def test_it_neither_uses_the_database_nor_the_cluster_of_another(tmp_path, monkeypatch):
    """It begins with what the command gives it: `adr demo` went on with another's runs."""
    monkeypatch.setenv("ADR_DATABASE_URL", "mysql://elsewhere")  # refused where it is read
    monkeypatch.setenv("ADR_RAY_ADDRESS", "nowhere")
    monkeypatch.setenv("ADR_HOST", "192.0.2.1")
    monkeypatch.setenv("ADR_RATE", "never")
    with (
        pytest.raises(ServiceDidNotStart, match="ADR_RATE: 'never' is no rate") as ended,
        own_service(tmp_path / "data", 9),
    ):
        pass
    assert "ADR_RAY_ADDRESS" not in str(ended.value)
    assert "listen" not in str(ended.value)
