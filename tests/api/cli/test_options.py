"""Options that several commands have."""

import pytest


@pytest.mark.parametrize("command", [["list"], ["status", "run_a"], ["results", "run_a"]], ids=str)
def test_the_address_of_the_service_may_come_from_the_environment(adr_here, monkeypatch, command):
    monkeypatch.setenv("ADR_URL", "http://127.0.0.1:9")
    code, _, errors = adr_here(*command)
    assert code == 5
    assert "127.0.0.1:9" in errors
