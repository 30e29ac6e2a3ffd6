"""The application: its routes, and a start that is refused."""

import asyncio
from types import SimpleNamespace

import anyio
import anyio.from_thread

from api import app as app_module
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


def test_runs_are_taken_up_again_and_again_however_many_have_expired(monkeypatch):
    """A second for each deletion: a backlog of a week's runs had delayed them for hours."""
    monkeypatch.setattr(app_module, "_ADOPT_S", 0.001)
    monkeypatch.setattr(app_module, "_BREAK_S", 3600.0)
    adopted = []

    async def look_after():
        enough = anyio.Event()

        def adopt():
            adopted.append(1)
            if len(adopted) == 3:
                anyio.from_thread.run_sync(enough.set)

        service = SimpleNamespace(
            orchestrator=SimpleNamespace(adopt=adopt),
            expired=lambda: [(None, "run_a"), (None, "run_b")],
            forget=lambda delete, id: None,
        )
        with anyio.fail_after(10):
            async with anyio.create_task_group() as tasks:
                tasks.start_soon(app_module._look_after, service)
                await enough.wait()
                tasks.cancel_scope.cancel()

    asyncio.run(look_after())
