"""The command line in this process, as a client of the tests' service."""

import pytest


@pytest.fixture
def adr(adr_here, service, tmp_path, monkeypatch):
    """Runs `adr` with these arguments against the service; returns exit status and output."""
    monkeypatch.setenv("ADR_URL", service.client.url)
    monkeypatch.chdir(tmp_path)

    def run(*arguments):
        code, out, errors = adr_here(*arguments)
        assert bool(errors) == (code >= 2) or code == 1, errors
        return code, out or errors

    return run
