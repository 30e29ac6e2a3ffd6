"""Options that several commands have."""

import pytest

from api.settings import read_settings


def test_commands_ask_at_the_port_on_which_the_server_listens(adr_here, monkeypatch):
    monkeypatch.delenv("ADR_URL", raising=False)
    monkeypatch.setenv("ADR_PORT", "9")
    assert read_settings().port == 9
    code, _, errors = adr_here("list")
    assert code == 5
    assert "127.0.0.1:9 " in errors
    monkeypatch.setenv("ADR_PORT", "nine")
    assert "ADR_PORT must be the number of a port; given 'nine'" in adr_here("list")[2]
    monkeypatch.setenv("ADR_URL", "http://127.0.0.1:10")
    assert "127.0.0.1:10 " in adr_here("list")[2]


@pytest.mark.parametrize("command", [["list"], ["status", "run_a"], ["results", "run_a"]], ids=str)
def test_the_address_of_the_service_may_come_from_the_environment(adr_here, monkeypatch, command):
    monkeypatch.setenv("ADR_URL", "http://127.0.0.1:9")
    code, _, errors = adr_here(*command)
    assert code == 5
    assert "127.0.0.1:9" in errors
