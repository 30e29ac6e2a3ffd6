"""What the routes work with: one database and one orchestrator."""

import logging
import shutil
import stat
import tempfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Annotated

from fastapi import Depends, Header, Request
from pydantic import BaseModel

import adr_service
from adr_service.benchmark.comparison import Outcome
from adr_service.benchmark.utilisation import utilisation
from adr_service.criticism.compatibility import check_measurement
from adr_service.criticism.measurements import Measurement, is_measurement
from adr_service.criticism.nominal import Nominal
from adr_service.errors import AdrError, InvalidInput
from adr_service.json_values import canonical_json, sha256
from adr_service.specs import AnyRun, CriticismSpec, RunSpec
from adr_service.target import Recording
from adr_service.tasks.catalogue import get_task, source_of
from api.settings import Settings
from api.views import CostView, cost_view, results_view
from db import datasets as dataset_store
from db import runs as store
from db import stages as stage_store
from db import target_tasks as task_store
from db.errors import DatabaseUnavailable, DiskFull, NotFound, NotPossible
from db.requests import RequestKey
from db.runs import RunRecord
from db.session import Database, open_database
from db.target_tasks import TargetTask
from workers.cluster import ClusterUnavailable, RayOptions
from workers.orchestrator import Orchestrator

log = logging.getLogger(__name__)


class QueueFull(AdrError):
    """There are too many live runs; later there are fewer."""

    code = "queue_full"


@dataclass(frozen=True)
class Service:
    settings: Settings
    database: Database
    orchestrator: Orchestrator

    def outcomes(self, records: Sequence[RunRecord]) -> list[Outcome]:
        """Everything that the runs have found so far, and how long it took."""
        specs = {record.id: record.spec for record in records}
        found = [
            (spec, event)
            for run_id, event in store.iterations_of(self.database, list(specs))
            if isinstance(spec := specs[run_id], RunSpec)
        ]
        digests = [digest for _, event in found for digest in event.inferences]
        seconds = stage_store.seconds_of(self.database, digests)
        return [
            Outcome(spec, event, sum(seconds[d] for d in event.inferences) or None)
            for spec, event in found
        ]

    def results(self, id: str, records: Sequence[RunRecord]) -> str:
        """The result table of a run or a benchmark, a ResultsView's JSON.

        Its bootstraps take seconds, so it is kept until one of the runs has found more.
        """
        found = store.count_iterations(self.database, [record.id for record in records])
        version = sha256(canonical_json([adr_service.__version__, found]).encode())
        known = store.kept_results(self.database, id, version)
        if known is None:
            known = results_view(self.outcomes(records)).model_dump_json()
            try:
                store.keep_results(self.database, id, version, known)
            except DatabaseUnavailable as error:
                log.warning("the results of %s are not kept: %s", id, error)
        return known

    def cost(self, records: Sequence[RunRecord]) -> CostView:
        """What the runs have cost so far."""
        timings = stage_store.timings_of(self.database, [record.id for record in records])
        used = None
        if timings and all(record.is_finished for record in records):
            first = min(timing.asked for _, timing in timings)
            last = max(timing.ended for _, timing in timings)
            # others' stages keep cores busy too
            used = utilisation(stage_store.timings_between(self.database, first, last))
        return cost_view(timings, used, self.outcomes(records))

    def check_dataset(self, spec: AnyRun) -> None:
        """Refuse a run that names a dataset which is not there, or not of its task."""
        if spec.dataset is None:
            return
        content = dataset_store.load_dataset(self.database, spec.dataset)[1]
        if is_measurement(content) != isinstance(spec, CriticismSpec):
            given = "not a" if isinstance(spec, CriticismSpec) else "a"
            raise InvalidInput(
                f"{spec.dataset} is {given} measurement of states and commands; `adr criticise` "
                "reads those (docs/criticism.md), methods learn from recordings of transitions "
                "(docs/recordings.md)"
            )
        if isinstance(spec, CriticismSpec):
            source = source_of(spec.task, spec.variant)
            nominal = Nominal.of_task(get_task(spec.task), source)
            check_measurement(nominal, Measurement.from_npz(content))
        else:
            Recording(spec, content)

    def check_queue(self, live: int) -> None:
        """Refuse what could not be run: too many runs, on no cores, on a disk nearly full."""
        if self.orchestrator.cores == 0 and self.settings.ray_address != "local":
            raise ClusterUnavailable(
                "the cluster has no cores, so nothing would ever run: add a node with some "
                "(ray start --address=HEAD:6379)"
            )
        self.check_disk()
        most = self.settings.max_live_runs
        if live > most:
            raise QueueFull(
                f"{live} runs would wait or run; accepted are {most} (ADR_MAX_LIVE_RUNS)"
            )

    @property
    def dashboard_url(self) -> str | None:
        """Where browsers reach Ray's dashboard."""
        return self.settings.ray_dashboard_url or self.orchestrator.dashboard_url

    def free_disk(self) -> int:
        """Bytes that are left where results are."""
        return shutil.disk_usage(self.settings.data_dir).free

    def check_disk(self) -> None:
        """Refuse new work while the disk is nearly full; what runs may end."""
        free, floor = self.free_disk(), self.settings.disk_floor_mb
        if free < floor * 1e6:
            raise DiskFull(
                f"the disk that has the results has {free / 1e6:.0f} MB left; new work is refused "
                f"below {floor} (ADR_DISK_FLOOR_MB): free some space, or delete runs"
            )

    def claim(self, worker: str, tasks: Sequence[str]) -> TargetTask | None:
        """A target task for a robot, if there is one; the lock is taken only then."""
        now = self.orchestrator.clock.now()
        if not task_store.is_one_free(self.database, tasks, now):
            return None
        return task_store.claim(self.database, worker, tasks, now, self.settings.lease_s)

    def expired(self) -> list[store.Deletion]:
        """What has finished before the time that it is kept for; nothing by default."""
        days = self.settings.retention_days
        if days is None:
            return []
        return store.finished_before(self.database, datetime.now(UTC) - timedelta(days=days))

    def forget(self, delete: Callable[[Database, str], None], id: str) -> None:
        """Delete something expired, if it still is."""
        try:
            delete(self.database, id)
        except (NotFound, NotPossible) as error:  # somebody was faster, or resumed it
            log.info("%s stays: %s", id, error)
        else:
            log.info("%s was deleted: it had been kept long enough", id)

    def close(self) -> None:
        self.orchestrator.close()
        self.database.close()


def open_service(settings: Settings) -> Service:
    """Open the database, start Ray, and go on with what is unfinished."""
    _prepare(settings.data_dir)
    database = open_database(settings.database)
    try:
        orchestrator = Orchestrator(database, _ray_options(settings))
        task_store.renew_leases(database, orchestrator.clock.now(), settings.lease_s)
        orchestrator.start()
    except BaseException:
        database.close()
        raise
    return Service(settings, database, orchestrator)


def _prepare(data_dir: Path) -> None:
    """A folder for results, and secrets, that nobody else on the machine can look into."""
    try:
        data_dir.mkdir(parents=True, exist_ok=True, mode=0o700)
        mode = stat.S_IMODE(data_dir.stat().st_mode)
        if mode & 0o077:
            data_dir.chmod(0o700)
            log.warning("%s was open to others (mode %o); now it is yours alone", data_dir, mode)
        with tempfile.TemporaryFile(dir=data_dir):
            pass  # it can be written
    except OSError as error:
        raise InvalidInput(f"there can be no data in {data_dir}: {error}") from error


def _ray_options(settings: Settings) -> RayOptions:
    return RayOptions(
        address=settings.ray_address,
        cpus=settings.cpus,
        dashboard=settings.dashboard,
        compile_cache=settings.data_dir.absolute() / "compile_cache",
        folder=settings.data_dir.absolute(),
    )


def _service(request: Request) -> Service:
    service: Service = request.app.state.service
    return service


def request_key(key: str | None, spec: BaseModel) -> RequestKey | None:
    """What tells a request that came twice."""
    if key is None:
        return None
    return RequestKey(key, sha256(f"{type(spec).__name__} {spec.model_dump_json()}".encode()))


IdempotencyKey = Annotated[
    str | None,
    Header(min_length=1, max_length=200, description="for a day, the same makes nothing new"),
]
ServiceDependency = Annotated[Service, Depends(_service)]
