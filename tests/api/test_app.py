"""The application: its routes, and a start that is refused."""

import asyncio

from api.app import create_app
from api.settings import Settings


def test_no_two_routes_answer_the_same_request():
    app = create_app(Settings())
    asked = [
        (method, route.path)
        for router in app.state.routers
        for route in router.routes
        for method in route.methods
    ]
    assert len(asked) == len(set(asked))


def test_two_applications_share_no_state():
    first, second = create_app(Settings()), create_app(Settings())
    first.state.mark = True
    assert not hasattr(second.state, "mark")


def test_a_refused_start_is_answered_with_the_reason(tmp_path):
    """The server logs this message."""
    (tmp_path / "adr.sqlite").write_text("a letter, and not a short one at all" * 20)
    sent = []

    async def receive():
        return {"type": "lifespan.startup"}

    async def send(message):
        sent.append(message)

    async def start():
        app = create_app(Settings(data_dir=tmp_path))
        try:
            await app({"type": "lifespan", "state": {}}, receive, send)
        except Exception:  # noqa: BLE001 - the server looks at the message alone
            return

    asyncio.run(start())
    assert [message["type"] for message in sent] == ["lifespan.startup.failed"]
    assert "adr.sqlite" in sent[0]["message"]
    assert "Traceback" not in sent[0]["message"]
