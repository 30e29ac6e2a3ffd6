"""ETag and If-None-Match for answers to GET: polling gets 304 while nothing changes."""

from starlette.datastructures import Headers, MutableHeaders
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from adr_service.json_values import sha256


class Etags:
    """Adds a tag to whole answers to GET; streams pass unchanged. Plain ASGI."""

    def __init__(self, app: ASGIApp):
        self._app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] == "http" and scope["method"] == "GET":
            known = Headers(scope=scope).get("if-none-match", "")
            # a proxy that compresses makes a tag weak
            tags = {tag.strip().removeprefix("W/") for tag in known.split(",")}
            send = _Tagged(send, tags).send
        await self._app(scope, receive, send)


class _Tagged:
    def __init__(self, send: Send, known: set[str]):
        self._send, self._known = send, known
        self._start: Message | None = None

    async def send(self, message: Message) -> None:
        if message["type"] == "http.response.start":
            # a stream does not say how long it is
            if message["status"] == 200 and "content-length" in Headers(raw=message["headers"]):
                self._start = message
                return
        elif self._start is not None:
            start, self._start = self._start, None
            if message.get("more_body"):  # it comes in parts, of which this is one
                await self._send(start)
                await self._send(message)
                return
            headers = MutableHeaders(raw=start["headers"])
            tag = headers.get("ETag")
            if tag is None:
                tag = headers["ETag"] = f'"{sha256(message["body"])[:32]}"'
            if tag in self._known or "*" in self._known:
                start["status"], message = 304, {**message, "body": b""}
                del headers["content-length"]
                start["headers"] = headers.raw
            await self._send(start)
        await self._send(message)
