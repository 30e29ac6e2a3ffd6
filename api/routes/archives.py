"""Benchmarks as files: /v1/benchmarks/{id}/archive writes one, /v1/archives reads one."""

import os
import tempfile
from collections.abc import Iterator
from contextlib import ExitStack
from typing import IO, Annotated

import anyio.to_thread
from fastapi import APIRouter, Depends, Query, Request
from fastapi.responses import StreamingResponse

from adr_service.specs import BenchmarkPart
from api.parameters import BenchmarkId
from api.routes.downloads import attachment
from api.service import Service, ServiceDependency
from api.uploads import OCTETS, octets
from db.archives import Imported, export_benchmark, import_benchmark
from db.staging import staged

router = APIRouter(prefix="/v1", tags=["benchmarks"])
_LARGEST = 8_000_000_000  # bytes
_PORTION = 2**18  # bytes that are sent or written at once
_BODY = {OCTETS: {"schema": {"type": "string", "format": "binary"}}}


class ImportView(Imported):
    """Report of an import, with links."""

    links: dict[str, str]


@router.get("/benchmarks/{benchmark_id}/archive", response_class=StreamingResponse)
def export(
    benchmark_id: BenchmarkId, part: Annotated[BenchmarkPart, Query()], service: ServiceDependency
) -> StreamingResponse:
    """The benchmark, or a part of it, as one file, finished or not.

    It has specs, events, results and policies. Parts that differ in one kind of member, as in their
    methods, are one benchmark again when they are imported one after the other.
    """
    service.check_disk()
    with ExitStack() as unless_sent:
        # it has no name, so nothing is left of it whatever happens
        folder = service.settings.data_dir
        file = unless_sent.enter_context(tempfile.TemporaryFile(dir=folder))
        export_benchmark(service.database, benchmark_id, file, part, service.check_disk)
        unless_sent.pop_all()
    size = file.seek(0, os.SEEK_END)
    headers = {**attachment(f"{benchmark_id}.adr"), "Content-Length": str(size)}
    return StreamingResponse(_portions(file), media_type=OCTETS, headers=headers)


@router.post(
    "/archives",
    max_body_size=_LARGEST,
    dependencies=[Depends(octets)],
    openapi_extra={"requestBody": {"required": True, "content": _BODY}},
)
async def import_archive(request: Request, service: ServiceDependency) -> ImportView:
    """Add what the database lacks of a benchmark's archive; importing again changes nothing."""
    with tempfile.TemporaryFile(dir=service.settings.data_dir) as file:
        async for portion in request.stream():
            await anyio.to_thread.run_sync(_keep, service, file, portion)
        return await anyio.to_thread.run_sync(_add, service, file)


def _portions(file: IO[bytes]) -> Iterator[bytes]:
    with file:
        file.seek(0)
        while portion := file.read(_PORTION):
            yield portion


def _keep(service: Service, file: IO[bytes], portion: bytes) -> None:
    service.check_disk()
    file.write(portion)


def _add(service: Service, file: IO[bytes]) -> ImportView:
    settings = service.settings
    with staged(file, settings.data_dir, 1e6 * settings.disk_floor_mb) as archived:
        added = import_benchmark(service.database, archived)
    return ImportView(**dict(added), links={"benchmark": f"/v1/benchmarks/{added.benchmark}"})
