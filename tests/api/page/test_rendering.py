"""The frame of all pages."""

from fastapi import FastAPI, Request
from fastapi.testclient import TestClient

from api.page.rendering import show


def test_without_scripts_a_live_page_reloads_once_a_minute():
    """Every reload drops what one has ticked."""
    app = FastAPI()

    @app.get("/")
    def page(request: Request, live: bool):
        return show(request, "base.html", live=live)

    client = TestClient(app)
    reload = '<noscript><meta http-equiv="refresh" content="60"></noscript>'
    assert reload in client.get("/?live=1").text
    assert "refresh" not in client.get("/?live=0").text
