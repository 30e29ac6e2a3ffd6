"""The HTTP application."""

import gc
import logging
import signal
import threading
from collections.abc import AsyncGenerator, Awaitable, Callable
from contextlib import asynccontextmanager
from functools import partial

import anyio
import anyio.to_thread
from fastapi import Depends, FastAPI
from starlette.datastructures import State
from starlette.staticfiles import StaticFiles
from starlette.types import ASGIApp, Message, Receive, Scope, Send

import adr_service
from adr_service.errors import AdrError
from api import errors, page
from api.errors import Problem
from api.etags import Etags
from api.guard import Guard
from api.page.problems import Problems
from api.page.rendering import STATIC
from api.parameters import check_parameters
from api.routes import (
    archives,
    benchmark_results,
    benchmarks,
    catalogue,
    claims,
    criticisms,
    datasets,
    events,
    run_results,
    runs,
    target_tasks,
    trainings,
)
from api.service import Service, open_service
from api.settings import Settings
from db.errors import DatabaseUnavailable

log = logging.getLogger(__name__)
_ADOPT_S = 60.0  # between two looks at what nobody has started, because an answer was lost
_UPKEEP_S = 3600.0  # between two looks at what has expired
_LOOK_S = 1.0  # between two looks at the dispatcher
_BREAK_S = 1.0  # between two deletions; each holds the database for up to a second
_RECLAIM_S = 10.0  # between two returns of free space to the disk


def create_app(settings: Settings, on_death: Callable[[], None] = lambda: None) -> FastAPI:
    """Return the service on these settings; it opens its database and Ray when it starts.

    `on_death` is called once it cannot compute any more, to end the process: a supervisor may start
    another.
    """
    app = FastAPI(
        title="ADR benchmark service",
        version=adr_service.__version__,
        docs_url=None,  # they load scripts from elsewhere; `api.page` has our own
        redoc_url=None,
        responses={
            "default": {
                "description": "What was refused, and what is accepted (RFC 9457)",
                "content": {"application/problem+json": {"schema": Problem.model_json_schema()}},
            }
        },
        lifespan=_serving,
    )
    app.state.settings, app.state.on_death = settings, on_death
    errors.install(app)
    families = (
        *(runs, events, run_results, trainings, benchmarks, benchmark_results, archives),
        *(criticisms, datasets, target_tasks, claims, catalogue),
    )
    app.state.routers = [*(family.router for family in families), *page.routers]
    for router in app.state.routers:
        is_page = router in page.routers  # an address that somebody shared may have more in it
        checks = [] if is_page else [Depends(check_parameters)]
        app.include_router(router, dependencies=checks)
    app.mount("/static", StaticFiles(directory=STATIC))
    app.add_middleware(Etags)
    app.add_middleware(Guard, settings=settings)
    app.add_middleware(Problems)
    app.add_middleware(_Starting, state=app.state)  # outermost
    return app


@asynccontextmanager
async def _serving(app: FastAPI) -> AsyncGenerator[None]:
    """Open the service, look after it while requests are answered, and close it."""
    try:
        service = await anyio.to_thread.run_sync(open_service, app.state.settings)
    except AdrError as error:
        app.state.refusal = error
        raise
    app.state.service = service
    _take_back_signals()
    gc.collect()
    gc.freeze()  # a collection that visits all that stays stops everyone for a quarter of a second
    try:
        async with anyio.create_task_group() as tasks:
            tasks.start_soon(_look_after, service)
            tasks.start_soon(_give_back_disk, service)
            tasks.start_soon(_watch_the_dispatcher, service, app.state.on_death)
            yield
            tasks.cancel_scope.cancel()
    finally:
        await anyio.to_thread.run_sync(service.close)


def _take_back_signals() -> None:
    """Restore Python's signal handlers; Ray's own report an ordinary stop as a crash."""
    if threading.current_thread() is threading.main_thread():
        for number in (signal.SIGINT, signal.SIGTERM):
            if (handler := signal.getsignal(number)) is not None:
                signal.signal(number, handler)


async def _look_after(service: Service) -> None:
    """Start runs that nobody has started, and delete expired ones; neither waits for the other."""
    async with anyio.create_task_group() as tasks:
        adopt = partial(anyio.to_thread.run_sync, service.orchestrator.adopt)
        tasks.start_soon(_again_and_again, adopt, _ADOPT_S)
        tasks.start_soon(_again_and_again, partial(_delete_expired, service), _UPKEEP_S)


async def _again_and_again(work: Callable[[], Awaitable[None]], pause_s: float) -> None:
    while True:
        try:
            await work()
        except DatabaseUnavailable as error:
            log.info("not everything was looked after: %s", error)
        except Exception:  # the next time tries again
            log.exception("not everything was looked after")
        await anyio.sleep(pause_s)


async def _delete_expired(service: Service) -> None:
    for delete, id in await anyio.to_thread.run_sync(service.expired):
        await anyio.to_thread.run_sync(service.forget, delete, id)
        await anyio.sleep(_BREAK_S)


async def _give_back_disk(service: Service) -> None:
    """Return the space of deleted rows to the disk, in portions, so that others can write."""
    while True:
        try:
            while await anyio.to_thread.run_sync(service.database.reclaim):
                pass
        except DatabaseUnavailable as error:
            log.info("free space is given back to the disk later: %s", error)
        except Exception:  # the database has more important users
            log.exception("free space could not be given back to the disk")
        await anyio.sleep(_RECLAIM_S)


async def _watch_the_dispatcher(service: Service, on_death: Callable[[], None]) -> None:
    """Call `on_death` once no run can go on."""
    while service.orchestrator.is_alive:
        await anyio.sleep(_LOOK_S)
    log.error("the service ends, because it cannot compute any more; start it again")
    on_death()


class _Starting:
    """Logs why the service does not start, without a trace unless it is a defect."""

    def __init__(self, app: ASGIApp, state: State):
        self._app, self._state = app, state

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        async def send_reason(message: Message) -> None:
            refusal = getattr(self._state, "refusal", None)
            if message["type"] == "lifespan.startup.failed" and refusal is not None:
                message["message"] = str(refusal)
            await send(message)

        await self._app(scope, receive, send_reason if scope["type"] == "lifespan" else send)
