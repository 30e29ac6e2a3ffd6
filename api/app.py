"""The HTTP application."""

import gc
import logging
import signal
import threading
from collections.abc import AsyncGenerator
from contextlib import asynccontextmanager

import anyio
import anyio.to_thread
from fastapi import FastAPI
from starlette.datastructures import State
from starlette.types import ASGIApp, Message, Receive, Scope, Send

import adr_service
from adr_service.errors import AdrError
from api import errors, page
from api.errors import Problem
from api.etags import Etags
from api.guard import Guard
from api.routes import benchmarks, catalogue, claims, criticisms, datasets, runs, target_tasks
from api.service import Service, open_service
from api.settings import Settings
from db.errors import DatabaseUnavailable

log = logging.getLogger(__name__)
_LOOK_AFTER_S = 3600.0
_GIVE_BACK_S = 10.0


def create_app(settings: Settings) -> FastAPI:
    """The service on these settings; opens its database and Ray when it starts."""

    @asynccontextmanager
    async def lifespan(app: FastAPI) -> AsyncGenerator[None]:
        try:
            service = await anyio.to_thread.run_sync(open_service, settings)
        except AdrError as error:
            app.state.refusal = error
            raise
        app.state.service = service
        _take_back_signals()
        gc.collect()
        gc.freeze()  # to look through all that stays stops everyone for a quarter of a second
        try:
            async with anyio.create_task_group() as tasks:
                tasks.start_soon(_look_after, service)
                tasks.start_soon(_give_back_disk, service)
                yield
                tasks.cancel_scope.cancel()
        finally:
            await anyio.to_thread.run_sync(service.close)

    app = FastAPI(
        title="ADR benchmark service",
        version=adr_service.__version__,
        lifespan=lifespan,
        docs_url=None,  # they load scripts from elsewhere; `api.page` has our own
        redoc_url=None,
        responses={
            "default": {
                "description": "What was refused, and what is accepted (RFC 9457)",
                "content": {"application/problem+json": {"schema": Problem.model_json_schema()}},
            }
        },
    )
    errors.install(app)
    parts = (runs, benchmarks, criticisms, datasets, target_tasks, claims, catalogue, page)
    app.state.routers = [part.router for part in parts]
    for router in app.state.routers:
        app.include_router(router)
    app.add_middleware(Etags)
    app.add_middleware(Guard, settings=settings)
    app.add_middleware(_Starting, state=app.state)  # outermost
    return app


def _take_back_signals() -> None:
    """Ray put handlers of its own before Python's, which tell of a stop as if it were a crash."""
    if threading.current_thread() is threading.main_thread():
        for number in (signal.SIGINT, signal.SIGTERM):
            if (handler := signal.getsignal(number)) is not None:
                signal.signal(number, handler)


async def _look_after(service: Service) -> None:
    """Every hour, delete what was kept long enough, and start what nobody has started."""
    while True:
        try:
            await anyio.to_thread.run_sync(service.orchestrator.adopt)
            for delete, id in await anyio.to_thread.run_sync(service.expired):
                await anyio.to_thread.run_sync(service.forget, delete, id)
        except Exception:  # there is another hour
            log.exception("not everything was looked after")
        await anyio.sleep(_LOOK_AFTER_S)


async def _give_back_disk(service: Service) -> None:
    """Give the disk back what deleting leaves free, in portions, between which others write."""
    while True:
        try:
            while await anyio.to_thread.run_sync(service.database.reclaim):
                pass
        except DatabaseUnavailable as error:
            log.info("free space is given back to the disk later: %s", error)
        except Exception:  # others have more to do with the database
            log.exception("free space could not be given back to the disk")
        await anyio.sleep(_GIVE_BACK_S)


class _Starting:
    """Says why the service does not start, without a trace where it is not a defect."""

    def __init__(self, app: ASGIApp, state: State):
        self._app, self._state = app, state

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        async def told(message: Message) -> None:
            refusal = getattr(self._state, "refusal", None)
            if message["type"] == "lifespan.startup.failed" and refusal is not None:
                message["message"] = str(refusal)
            await send(message)

        await self._app(scope, receive, told if scope["type"] == "lifespan" else send)
