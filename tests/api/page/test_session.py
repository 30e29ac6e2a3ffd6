"""Logging in by a browser."""

from types import SimpleNamespace

import pytest
from fastapi import FastAPI
from fastapi.testclient import TestClient

from api.page import session
from api.settings import Settings

TOKEN = "u" * 32


@pytest.fixture
def client():
    app = FastAPI()
    app.include_router(session.router)
    app.state.service = SimpleNamespace(settings=Settings(token=TOKEN))
    return TestClient(app, follow_redirects=False)


@pytest.mark.parametrize("ids", [45, 600])
def test_a_login_leads_to_an_address_as_long_as_one_may_be(client, ids):
    address = "/compare?" + "&".join(f"id=run_{i:016x}" for i in range(ids))
    assert 1000 < len(address) < 16_384  # bytes of all headers
    entered = client.post("/login", data={"token": TOKEN, "next": address})
    assert (entered.status_code, entered.headers["Location"]) == (303, address)


@pytest.mark.parametrize("address", ["https://evil.example", "//evil.example", "/\\evil.example"])
def test_a_login_leads_to_no_other_site(client, address):
    """Browsers take a backslash for a slash."""
    entered = client.post("/login", data={"token": TOKEN, "next": address})
    assert (entered.status_code, entered.headers["Location"]) == (303, "/")


def test_who_enters_the_address_of_the_login_gets_the_first_page(client):
    """A browser stays at that address after a wrong token."""
    answer = client.get("/login")
    assert (answer.status_code, answer.headers["Location"]) == (303, "/")


@pytest.mark.parametrize("scheme", ["http", "https"])
def test_the_cookie_of_an_encrypted_login_is_never_sent_in_the_clear(client, scheme):
    entered = client.post(f"{scheme}://testserver/login", data={"token": TOKEN})
    assert ("Secure" in entered.headers["Set-Cookie"]) == (scheme == "https")
