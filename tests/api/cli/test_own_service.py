"""A service of one's own, beside the one that variables name."""

import socket

import pytest

from adr_service.errors import InvalidInput
from api.cli.own_service import ServiceDidNotStart, _own, own_service


def test_it_keeps_the_settings_that_name_nothing_shared(monkeypatch):
    shared = ("ADR_DATABASE_URL", "ADR_RAY_ADDRESS", "RAY_ADDRESS", "ADR_HOST")
    for name in (*shared, "ADR_MAX_CORES", "ADR_RESOURCE", "ADR_TOKEN"):
        monkeypatch.setenv(name, "x")
    left = {name for name in _own() if name.startswith(("ADR_", "RAY_"))}
    assert "ADR_TOKEN" in left
    assert not left & {*shared, "ADR_MAX_CORES", "ADR_RESOURCE"}


def test_it_does_not_take_another_service_for_its_own(tmp_path):
    """One that listens there already would answer first, and get the demo's benchmark."""
    with socket.create_server(("127.0.0.1", 0)) as other:
        port = other.getsockname()[1]
        with (
            pytest.raises(InvalidInput, match=f"cannot listen on 127.0.0.1 port {port}"),
            own_service(tmp_path / "data", port),
        ):
            pass
    assert not (tmp_path / "data").exists()


def test_it_neither_uses_the_database_nor_the_cluster_of_another(tmp_path, monkeypatch):
    """It begins with what the command gives it: `adr demo` went on with another's runs."""
    monkeypatch.setenv("ADR_RAY_ADDRESS", "nowhere")
    monkeypatch.setenv("ADR_RATE", "never")
    with (
        pytest.raises(ServiceDidNotStart, match="ADR_RATE: 'never' is no rate") as ended,
        own_service(tmp_path / "data", 9),
    ):
        pass
    assert "ADR_RAY_ADDRESS" not in str(ended.value)
