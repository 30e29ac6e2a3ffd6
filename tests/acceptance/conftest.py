"""A secret for the tests of clusters."""

import pytest


@pytest.fixture
def secret(tmp_path):
    """Environment with the token that all processes of a cluster share."""
    token = tmp_path / "token"
    token.write_text("t" * 40)
    return {"RAY_AUTH_MODE": "token", "RAY_AUTH_TOKEN_PATH": str(token)}
