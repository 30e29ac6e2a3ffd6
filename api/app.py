"""The HTTP application."""

import hmac
from collections.abc import AsyncGenerator, Awaitable, Callable
from contextlib import asynccontextmanager

import anyio.to_thread
from fastapi import FastAPI, Request, Response

import adr_service
from api import errors, page
from api.routes import benchmarks, catalogue, claims, criticisms, datasets, runs, target_tasks
from api.service import open_service
from api.settings import Settings

_OPEN_PATHS = {"/healthz"}  # for health checks, which hold no secret


def create_app(settings: Settings) -> FastAPI:
    """The service on these settings; opens its database and Ray when it starts."""

    @asynccontextmanager
    async def lifespan(app: FastAPI) -> AsyncGenerator[None]:
        service = await anyio.to_thread.run_sync(open_service, settings)
        app.state.service = service
        yield
        await anyio.to_thread.run_sync(service.close)

    app = FastAPI(
        title="ADR benchmark service",
        version=adr_service.__version__,
        lifespan=lifespan,
        max_body_size=1_000_000,
    )
    errors.install(app)
    for routes in (runs, benchmarks, criticisms, datasets, target_tasks, claims, catalogue, page):
        app.include_router(routes.router)
    if settings.token:
        app.middleware("http")(_token_check(settings.token))
    return app


def _token_check(
    token: str,
) -> Callable[[Request, Callable[[Request], Awaitable[Response]]], Awaitable[Response]]:
    """Middleware that lets only holders of the token in."""
    expected = f"Bearer {token}".encode()

    async def check(
        request: Request, call_next: Callable[[Request], Awaitable[Response]]
    ) -> Response:
        given = request.headers.get("Authorization", "").encode()
        if request.url.path in _OPEN_PATHS or hmac.compare_digest(given, expected):
            return await call_next(request)
        detail = "send the service's token in the header 'Authorization: Bearer …'"
        response = errors.problem(401, "unauthorised", detail)
        response.headers["WWW-Authenticate"] = "Bearer"
        return response

    return check
