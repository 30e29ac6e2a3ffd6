"""ETag and If-None-Match for answers to GET: polling gets 304 while nothing changes."""

from starlette.datastructures import Headers, MutableHeaders
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from adr_service.json_values import sha256


class Etags:
    """Adds a tag to whole answers to GET, which are asked for again each time: else a browser may
    use a script of before an upgrade for days. Streams pass unchanged. Plain ASGI."""

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
        self._is_known = False

    async def send(self, message: Message) -> None:
        if message["type"] == "http.response.start":
            # a stream does not say how long it is
            if message["status"] == 200 and "content-length" in Headers(raw=message["headers"]):
                self._start = message
                return
        elif self._start is not None:
            start, self._start = self._start, None
            headers = MutableHeaders(raw=start["headers"])
            headers.setdefault("Cache-Control", "no-cache")
            tag = headers.get("ETag")
            if tag is None and not message.get("more_body"):  # else it comes in parts
                tag = headers["ETag"] = f'"{sha256(message["body"])[:32]}"'
            if tag is not None and (tag in self._known or "*" in self._known):
                start["status"], message = 304, {"type": message["type"], "body": b""}
                del headers["content-length"]
                self._is_known = True
            start["headers"] = headers.raw
            await self._send(start)
        elif self._is_known:  # the other parts
            return
        await self._send(message)
