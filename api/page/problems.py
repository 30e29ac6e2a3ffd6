"""Refusals for people: problem documents become pages where a browser asks for a page."""

import json
from collections.abc import Mapping
from typing import Any

from fastapi import Request, Response
from starlette.datastructures import Headers
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from api.errors import DEFECT
from api.guard import protect
from api.page.rendering import show


class Problems:
    """Shows problems as HTML to those who accept that. Plain ASGI, around everything else."""

    def __init__(self, app: ASGIApp):
        self._app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] != "http" or "text/html" not in Headers(scope=scope).get("accept", ""):
            await self._app(scope, receive, send)
            return
        shown = _Shown(scope, receive, send)
        try:
            await self._app(scope, receive, shown.send)
        except Exception:  # any defect; a browser gets a page, and the log the error
            if not shown.has_begun:
                defect = {"status": 500, "title": "internal", "detail": DEFECT}
                page = problem_page(scope, defect, "/")
                protect(page.headers)
                await page(scope, receive, send)
            raise


class _Shown:
    def __init__(self, scope: Scope, receive: Receive, send: Send):
        self._scope, self._receive, self._send = scope, receive, send
        self._start: Message | None = None
        self._body = b""
        self.has_begun = False

    async def send(self, message: Message) -> None:
        if message["type"] == "http.response.start":
            if "problem+json" in Headers(raw=message["headers"]).get("content-type", ""):
                self._start = message
                return
        elif self._start is not None:
            self._body += message.get("body", b"")
            if not message.get("more_body"):
                await self._show(self._start)
            return
        self.has_begun = True
        await self._send(message)

    async def _show(self, start: Message) -> None:
        self.has_begun = True
        query = self._scope["query_string"].decode("latin-1")
        asked = self._scope["path"] + (f"?{query}" if query else "")
        address = asked if self._scope["method"] == "GET" else "/"
        page = problem_page(self._scope, json.loads(self._body), address)
        for name, value in Headers(raw=start["headers"]).items():
            # a browser that is asked for a password shows its own window, not our form
            if name not in ("content-type", "content-length", "www-authenticate"):
                page.headers.setdefault(name, value)
        await page(self._scope, self._receive, self._send)


def problem_page(scope: Scope, problem: Mapping[str, Any], next: str) -> Response:
    """A problem as a page; after a login it goes on at the address `next`."""
    status = problem["status"]
    return show(Request(scope), "problem.html", status_code=status, problem=problem, next=next)
