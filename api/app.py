"""The HTTP application."""

from collections.abc import AsyncGenerator
from contextlib import asynccontextmanager

import anyio.to_thread
from fastapi import FastAPI

import adr_service
from api import errors, page
from api.errors import Problem
from api.etags import Etags
from api.guard import Guard
from api.routes import benchmarks, catalogue, claims, criticisms, datasets, runs, target_tasks
from api.service import open_service
from api.settings import Settings


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
    app.add_middleware(Guard, settings=settings)  # outermost
    return app
