"""Limits on hosts, origins, tokens, rates and bodies, and the headers that protect browsers.

Plain ASGI, so that streams pass through unbuffered.
"""

import base64
import hmac
import math
import re
import time

from limits import parse_many
from limits.storage import MemoryStorage
from limits.strategies import FixedWindowRateLimiter
from python_multipart.multipart import parse_options_header
from starlette.datastructures import Headers, MutableHeaders
from starlette.middleware.body_limit import MAX_BODY_SIZE_SCOPE_KEY, RequestBodyLimitMiddleware
from starlette.requests import cookie_parser
from starlette.responses import Response
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from api.errors import problem
from api.settings import Settings

COOKIE = "adr_token"  # of a browser that has logged in
# for health checks, and for the page that asks for the token: they hold no secret
_OPEN_PATHS = re.compile(r"/healthz|/login|/static/.*")
_ROBOT_PATHS = re.compile(r"/v1/target_tasks(/.*)?|/v1/tasks|/readyz|/version")
_LARGEST_BODY = 1_000_000  # bytes; routes that take files have their own
_LONGEST = 200  # characters of an origin that a problem repeats
_READING = {"GET", "HEAD", "OPTIONS"}
_LOOPBACK = {"127.0.0.1", "localhost", "::1"}
_EVERY_ADDRESS = {"0.0.0.0", "::"}  # noqa: S104 - known, not used
_HEADERS = {
    # pages have our own files and nothing from elsewhere; reports have styles inside
    "Content-Security-Policy": "default-src 'none'; script-src 'self'; connect-src 'self'; "
    "img-src 'self' data:; media-src 'self'; style-src 'self' 'unsafe-inline'; base-uri 'none'; "
    "form-action 'self'; frame-ancestors 'none'",
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "same-origin",  # without it, our own forms would have no origin
    "Cross-Origin-Resource-Policy": "same-origin",
}


class Guard:
    """Refuses unknown hosts, too many requests, wrong tokens and large bodies."""

    def __init__(self, app: ASGIApp, settings: Settings):
        self._app = RequestBodyLimitMiddleware(app, _LARGEST_BODY)
        self._user = settings.token.get_secret_value()
        self._robot = settings.robot_token.get_secret_value()
        self._cookie = cookie_of(self._user)
        self._hosts = _hosts(settings)
        self._rates = parse_many(settings.rate)
        self._limiter = FixedWindowRateLimiter(MemoryStorage())

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return
        answer = _Answer(scope, receive, send)
        refusal = self._refusal(scope)
        if refusal is not None:
            await refusal(scope, receive, answer.send)
            return
        await self._app(scope, receive, answer.send)

    def _refusal(self, scope: Scope) -> Response | None:
        headers = Headers(scope=scope)
        return (
            self._unknown_host(headers.get("host", ""))
            or self._too_many(scope["client"][0] if scope.get("client") else "")
            or self._from_elsewhere(headers, scope["method"])
            or _strange_charset(headers)
            or self._not_allowed(headers, scope["method"], scope["path"])
        )

    def _unknown_host(self, given: str) -> Response | None:
        host = _without_port(given).lower()
        if self._hosts is None or host in self._hosts:
            return None
        accepted = ", ".join(sorted(self._hosts))
        detail = f"{host!r} is not a name of this service; accepted: {accepted} (ADR_ALLOWED_HOSTS)"
        return problem(400, "unknown_host", detail)

    def _from_elsewhere(self, headers: Headers, method: str) -> Response | None:
        """Refuse requests that change something and whose Origin is another site (CSRF)."""
        origin, host = headers.get("origin"), headers.get("host", "")
        if method in _READING or origin is None:
            return None
        name = origin.partition("://")[2]
        if name == host:
            return None
        detail = f"pages of {origin[:_LONGEST]!r} may not change anything here"
        if name and self._unknown_host(name) is None:
            detail += (
                f": the request came for {host[:_LONGEST]!r}. If a proxy is before the service, "
                "let it pass the browser's Host on (nginx: proxy_set_header Host $http_host)"
            )
        return problem(403, "foreign_origin", detail)

    def _too_many(self, client: str) -> Response | None:
        # the library's windows follow the wall clock, which may be set back by hours: so each
        # window of a steady clock is a key of its own there
        for rate in self._rates:
            window = rate.get_expiry()
            number, passed = divmod(time.monotonic(), window)
            if not self._limiter.hit(rate, client, f"{number:.0f}"):
                refusal = problem(429, "too_many_requests", f"an address may send {rate}")
                refusal.headers["Retry-After"] = str(max(1, math.ceil(window - passed)))
                return refusal
        return None

    def _not_allowed(self, headers: Headers, method: str, path: str) -> Response | None:
        if not self._user or _OPEN_PATHS.fullmatch(path):
            return None
        given = _token(headers, method)
        if not given and hmac.compare_digest(_cookie(headers), self._cookie.encode()):
            return None
        if hmac.compare_digest(given, self._user.encode()):
            return None
        if self._robot and hmac.compare_digest(given, self._robot.encode()):
            if _ROBOT_PATHS.fullmatch(path):
                return None
            detail = "a robot's token opens /v1/target_tasks, /v1/tasks, /readyz and /version"
            return problem(403, "forbidden", detail)
        detail = "send the service's token in the header 'Authorization: Bearer …'"
        refusal = problem(401, "unauthorised", detail)
        # a browser asks for it as a password, under any name
        refusal.headers["WWW-Authenticate"] = 'Bearer, Basic realm="ADR: the token as password"'
        return refusal


class _Answer:
    """Adds the headers of every answer, and explains a refusal of a large body."""

    def __init__(self, scope: Scope, receive: Receive, send: Send):
        self._scope, self._receive, self._send = scope, receive, send
        self._replaced = False

    async def send(self, message: Message) -> None:
        if self._replaced:
            return
        if message["type"] == "http.response.start":
            headers = MutableHeaders(raw=message["headers"])
            if message["status"] == 413:
                self._replaced = True
                most = self._scope.get(MAX_BODY_SIZE_SCOPE_KEY, _LARGEST_BODY)
                detail = f"the body may have {most} bytes here"
                await problem(413, "too_large", detail)(self._scope, self._receive, self._plain)
                return
            protect(headers)
        await self._send(message)

    async def _plain(self, message: Message) -> None:
        if message["type"] == "http.response.start":
            protect(MutableHeaders(raw=message["headers"]))
        await self._send(message)


def protect(headers: MutableHeaders) -> None:
    """Add the headers that protect browsers."""
    for name, value in _HEADERS.items():
        headers.setdefault(name, value)


def _strange_charset(headers: Headers) -> Response | None:
    """Refuse bodies in another charset: to decode a form in punycode takes minutes."""
    given = headers.get("content-type", "")
    charset = parse_options_header(given)[1].get(b"charset", b"utf-8")
    if charset.lower() in (b"utf-8", b"utf8"):
        return None
    detail = f"bodies are in utf-8 here; given {given[:_LONGEST]!r}"
    return problem(415, "unknown_charset", detail)


def _hosts(settings: Settings) -> set[str] | None:
    """Accepted names of the service; None: any, if it listens for everyone with a token."""
    given = {name.strip() for name in settings.allowed_hosts.split(",") if name.strip()}
    if not given and settings.host in _EVERY_ADDRESS:
        return None
    return _LOOPBACK | {name.lower() for name in (*given, settings.host)}


def _without_port(host: str) -> str:
    if host.startswith("["):  # IPv6
        return host[1:].partition("]")[0]
    return host.partition(":")[0]


def _token(headers: Headers, method: str) -> bytes:
    """Return the token of a request.

    Browsers resend passwords, so those only allow reading.
    """
    kind, _, value = headers.get("authorization", "").partition(" ")
    if kind.lower() == "bearer":
        return value.encode("latin-1")  # as it was sent
    if kind.lower() == "basic" and method in ("GET", "HEAD"):
        try:
            return base64.b64decode(value, validate=True).partition(b":")[2]
        except ValueError:
            return b""
    return b""


def _cookie(headers: Headers) -> bytes:
    """Return the cookie of a login, which browsers send from our own pages alone."""
    return cookie_parser(headers.get("cookie", "")).get(COOKIE, "").encode()


def cookie_of(token: str) -> str:
    """Return what a browser keeps after a login by a token; nobody gets the token from it."""
    return hmac.new(token.encode(), b"cookie of a login", "sha256").hexdigest()
