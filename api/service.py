"""The service that the routes use: one database and one orchestrator."""

import logging
import os
import shutil
from collections import defaultdict
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field
from datetime import UTC, datetime, timedelta
from threading import Lock
from typing import Annotated, Any

from fastapi import Depends, Request

from adr_service.errors import AdrError
from adr_service.specs import AnyRun
from api.data_folder import prepare_folder
from api.filming import Films
from api.settings import Settings
from api.uploads import check_dataset
from db import benchmarks as benchmark_store
from db import datasets as dataset_store
from db import staging
from db import visits as visit_store
from db.errors import DiskFull, NotFound, NotPossible
from db.session import Database, open_database
from db.visits import Visit
from workers.cluster import ClusterUnavailable, RayOptions
from workers.orchestrator import RUNS_AT_ONCE, Orchestrator

log = logging.getLogger(__name__)
_CLOCK_SET = timedelta(hours=1)  # more than a clock drifts, or is corrected by


class QueueFull(AdrError):
    """Too many runs are live; the request may be sent again later."""

    code = "queue_full"


@dataclass(frozen=True)
class Service:
    settings: Settings
    database: Database
    orchestrator: Orchestrator
    films: Films
    # held while the results of a run or a benchmark are compared, by its id
    comparing: defaultdict[str, Lock] = field(default_factory=lambda: defaultdict(Lock))
    # the latest reports on the paper's claims, by digest of the iteration counts
    claims: dict[str, list[dict[str, Any]]] = field(default_factory=dict)
    claiming: Lock = field(default_factory=Lock)  # held while they are computed
    # the best methods on the first page with the moment of a benchmark's last change, by benchmark
    leaders: dict[str, tuple[datetime, dict[str, Any] | None]] = field(default_factory=dict)

    def check_dataset(self, spec: AnyRun) -> None:
        """Refuse a run whose dataset is unknown, or not of its task."""
        if spec.dataset is None:
            return
        check_dataset(spec, dataset_store.load_dataset(self.database, spec.dataset)[1])

    def check_queue(self, live: int) -> None:
        """Raise an error if there are too many runs, no cores, or too little disk for more runs."""
        self.check_cores()
        self.check_disk()
        most = self.settings.max_live_runs
        if live > most:
            raise QueueFull(
                f"{live} runs would wait or run; accepted are {most} (ADR_MAX_LIVE_RUNS)"
            )

    def check_cores(self) -> None:
        """Raise ClusterUnavailable if there are no cores, and no autoscaler is asked for any."""
        settings = self.settings
        if self.orchestrator.cores or settings.ray_address == "local" or settings.max_cores:
            return
        raise ClusterUnavailable(
            f"no node of the cluster has any {settings.resource}, so nothing would ever run: add "
            "one (ray start --address=HEAD:6379), or set ADR_MAX_CORES for its autoscaler"
        )

    @property
    def dashboard_url(self) -> str | None:
        """Address of Ray's dashboard for browsers."""
        return self.settings.ray_dashboard_url or self.orchestrator.dashboard_url

    def free_disk(self) -> int:
        """Free bytes on the disk of the results; of several disks, on the one with fewest."""
        return min(shutil.disk_usage(folder).free for folder in self.settings.folders)

    def check_disk(self) -> None:
        """Raise DiskFull if the disk is nearly full; live runs may end."""
        free, floor = self.free_disk(), self.settings.disk_floor_mb
        if free < floor * 1e6:
            raise DiskFull(
                f"the disk that has the results has {free / 1e6:.0f} MB left; new work is refused "
                f"below {floor} (ADR_DISK_FLOOR_MB): free some space, or delete runs"
            )

    def claim(self, worker: str, tasks: Sequence[str]) -> Visit | None:
        """Claim a visit for a robot, if one is free; only then is the database locked."""
        now = self.orchestrator.clock.now()
        if not visit_store.is_one_free(self.database, tasks, now):
            return None
        return visit_store.claim(self.database, worker, tasks, now, self.settings.lease_s)

    def expired(self) -> list[benchmark_store.Deletion]:
        """Runs and benchmarks that have been kept for `retention_days`, each with its deletion.

        Nothing expires while the wall clock and the steady one disagree by more than an hour: what
        is deleted is lost.
        """
        days = self.settings.retention_days
        if days is None:
            return []
        wall, steady = datetime.now(UTC), self.orchestrator.clock.now()
        if abs(wall - steady) > _CLOCK_SET:
            log.warning(
                "nothing is deleted: the clock says %s, but since the service started it has "
                "become %s; correct the clock, or restart the service if it is right",
                *(f"{time:%Y-%m-%d %H:%M}" for time in (wall, steady)),
            )
            return []
        return benchmark_store.finished_before(self.database, wall - timedelta(days=days))

    def forget(self, delete: Callable[[Database, str], None], id: str) -> None:
        """Delete an expired run or benchmark, unless it has changed meanwhile."""
        try:
            delete(self.database, id)
        except (NotFound, NotPossible) as error:  # somebody was faster, or resumed it
            log.info("%s stays: %s", id, error)
        else:
            log.info("%s was deleted: it had been kept long enough", id)

    def close(self) -> None:
        self.films.close()
        self.orchestrator.close()
        self.database.close()


def open_service(settings: Settings) -> Service:
    """Open the database, start Ray, and continue unfinished runs."""
    prepare_folder(settings.data_dir)
    with ExitStack() as undone:
        database = open_database(settings.database)
        undone.callback(database.close)
        runs = _runs_at_once(settings)
        orchestrator = Orchestrator(database, _ray_options(settings), runs_at_once=runs)
        undone.callback(orchestrator.close)
        orchestrator.start()
        staging.clear(settings.data_dir)  # only now: the start refuses a folder in use
        # last: a lease of a few seconds would not outlast the start of Ray
        visit_store.renew_leases(database, orchestrator.clock.now(), settings.lease_s)
        undone.pop_all()
    return Service(settings, database, orchestrator, Films(settings.data_dir / "films"))


def _ray_options(settings: Settings) -> RayOptions:
    return RayOptions(
        address=settings.ray_address,
        cpus=settings.cpus,
        dashboard=settings.dashboard,
        compile_cache=settings.data_dir.absolute() / "compile_cache",
        folder=settings.data_dir.absolute(),
        keep_idle_s=settings.keep_idle_s,
        resource=settings.resource,
        max_cores=settings.max_cores,
    )


def _runs_at_once(settings: Settings) -> int:
    """Two for each core that is known: a run keeps one busy, but for its pauses."""
    here = len(os.sched_getaffinity(0)) if settings.ray_address == "local" else 0
    cores = settings.max_cores or settings.cpus or here
    return settings.runs_at_once or max(RUNS_AT_ONCE, 2 * cores)


async def _service(request: Request) -> Service:  # a function that waits for no thread
    service: Service = request.app.state.service
    return service


ServiceDependency = Annotated[Service, Depends(_service)]
