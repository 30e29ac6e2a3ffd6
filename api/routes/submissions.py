"""Submissions: a spec is stored once for each Idempotency-Key, and its runs are started."""

from collections.abc import Generator, Iterable, Sequence
from contextlib import contextmanager
from typing import Annotated

from fastapi import Header
from pydantic import BaseModel

from adr_service.benchmark.plan import Plan, plan
from adr_service.client.http import LONGEST_KEY
from adr_service.json_values import sha256
from adr_service.methods.catalogue import check_installed
from adr_service.specs import AnyRun, BenchmarkExtension, BenchmarkSpec, RunSpec
from adr_service.stages.base import StageResult
from adr_service.training.settings import check_backend
from api.service import Service
from db import benchmarks as benchmark_store
from db import datasets as dataset_store
from db import runs as run_store
from db import stages as stage_store
from db.benchmarks import BenchmarkRecord
from db.errors import NotFound, NotPossible
from db.requests import Replayed, RequestKey
from db.runs import RunRecord

IdempotencyKey = Annotated[
    str | None,
    Header(
        min_length=1,
        max_length=LONGEST_KEY,
        description="a request with the same key makes nothing new for a day",
    ),
]


def start_run(service: Service, spec: AnyRun, key: str | None) -> RunRecord:
    """Store a run and start it; return the earlier run if the key has started one."""
    if isinstance(spec, RunSpec):
        check_packages([spec])
    try:
        record = run_store.create_run(
            service.database, spec, _request_key(key, spec), service.check_queue
        )
    except Replayed as before:
        with _unless_deleted(before.id):
            record = run_store.get_run(service.database, before.id)
    if not record.is_finished:
        service.orchestrator.submit(record)
    return record


def start_benchmark(service: Service, spec: BenchmarkSpec, key: str | None) -> BenchmarkRecord:
    """Store a benchmark and start its runs; return the earlier one if the key has started one."""
    check_packages(spec.runs())
    try:
        record = benchmark_store.create_benchmark(
            service.database, spec, _request_key(key, spec), service.check_queue
        )
    except Replayed as before:
        with _unless_deleted(before.id):
            record = benchmark_store.get_benchmark(service.database, before.id)
    for run in benchmark_store.runs_of(service.database, record.id):
        if not run.is_finished:
            service.orchestrator.submit(run)
    return record


def extend_benchmark(
    service: Service, id: str, extension: BenchmarkExtension, key: str | None
) -> None:
    """Add runs to a benchmark and start them; a request with the same key adds them once."""
    given = (service.database, id, extension, _request_key(key, extension, id))
    try:
        check_packages(benchmark_store.planned_extension(*given)[1])
        added = benchmark_store.extend_benchmark(*given, service.check_queue)
    except Replayed:
        added = benchmark_store.runs_of(service.database, id)
    for run in added:
        if not run.is_finished:
            service.orchestrator.submit(run)


@contextmanager
def _unless_deleted(id: str) -> Generator[None]:
    """Raise NotPossible if what an earlier request created is not there any more."""
    try:
        yield
    except NotFound as error:
        raise NotPossible(
            f"the request with this Idempotency-Key created {id}, which was deleted; use a new "
            "key for a new request"
        ) from error


def check_packages(specs: Iterable[RunSpec]) -> None:
    """Raise InvalidInput for a method or a backend whose package is not installed here."""
    for method, backend in {(spec.method.name, spec.training.backend): None for spec in specs}:
        check_installed(method)
        check_backend(backend)


def plan_here(service: Service, specs: Sequence[RunSpec]) -> Plan:
    """Return the expected cost of runs on this cluster, if what they need is installed."""
    check_packages(specs)
    return price(service, specs)


def price(service: Service, specs: Sequence[RunSpec]) -> Plan:
    """Return the expected cost of runs on this cluster, also of methods without their extra."""

    def recording(spec: AnyRun) -> bytes | None:
        id = spec.dataset
        return None if id is None else dataset_store.load_dataset(service.database, id)[1]

    def find(digest: str) -> StageResult | None:
        with service.database.read() as session:
            return stage_store.find_result(session, digest)

    return plan(specs, service.orchestrator.cores, recording, find=find)


def _request_key(key: str | None, body: BaseModel, id: str = "") -> RequestKey | None:
    """Return the key together with the digest of its request, which may change the thing `id`."""
    if key is None:
        return None
    request = f"{type(body).__name__}{id} {body.model_dump_json()}"
    return RequestKey(key, sha256(request.encode()))
