"""What the dispatcher asks of the database, and tells it: results, checkpoints, target tasks."""

from collections.abc import Sequence
from dataclasses import asdict
from datetime import UTC, datetime
from typing import Protocol

from sqlalchemy.orm import Session

from adr_service.benchmark.utilisation import Timing
from adr_service.events import RunEvent
from adr_service.json_values import canonical_json
from adr_service.progress import SoFar
from adr_service.stages import KINDS, Stage, StageResult, events_of, learning_curve
from db import runs as run_store
from db import stages as stage_store
from db import target_tasks as task_store
from db.session import Database
from workers.actors import Finished
from workers.attempt import Attempt

_LEASE_S = 3600.0  # of the simulated target, which is watched by its signs of life


class Ledger(Protocol):
    """Every function may raise DatabaseUnavailable, and is then tried again."""

    def find(self, stage: Stage, run_id: str) -> StageResult | None:
        """A stored result, which from now on this run refers to as well.

        Where there is none, a robot's stage is offered to robots.
        """
        ...

    def begin(self, stage: Stage, run_id: str, worker: str) -> str | None:
        """The lease under which a process begins a stage; None: it needs none."""
        ...

    def drop(self, stage: Stage) -> None:
        """A stage that was begun under a lease led to nothing, and nobody wants it any more."""
        ...

    def commit(
        self, stage: Stage, finished: Finished, attempt: Attempt, run_ids: Sequence[str]
    ) -> None:
        """Store a result, and put it on the record of the runs that waited for it."""
        ...

    def note(self, stage: Stage, so_far: SoFar, run_ids: Sequence[str]) -> None:
        """Store the learning curve and the best policy of a training that goes on."""
        ...


class DatabaseLedger:
    """The ledger of the service; one function per transaction."""

    def __init__(self, database: Database):
        self._database = database

    def find(self, stage: Stage, run_id: str) -> StageResult | None:
        with self._database.write("find_result") as session:
            result = stage_store.find_result(session, stage.digest)
            if result is not None:
                append_to_all(session, [run_id], events_of(stage, result))
            elif _role(stage) == "robot":
                task_store.publish(session, stage, run_id, datetime.now(UTC))
            return result

    def begin(self, stage: Stage, run_id: str, worker: str) -> str | None:
        if _role(stage) != "target":
            return None
        now = datetime.now(UTC)
        with self._database.write("claim_simulated") as session:
            return task_store.claim_simulated(session, stage, run_id, worker, now, _LEASE_S)

    def drop(self, stage: Stage) -> None:
        task_store.drop_simulated(self._database, stage.digest)

    def commit(
        self, stage: Stage, finished: Finished, attempt: Attempt, run_ids: Sequence[str]
    ) -> None:
        timing = Timing(
            asked=attempt.asked,
            placed=attempt.placed,
            cores=attempt.cores,
            **asdict(finished.work),
        )
        seconds, result = timing.ended - timing.began, finished.result
        execution = stage_store.Execution(
            attempt.number, attempt.started_by, seconds, timing, finished.provenance
        )
        document = canonical_json(stage.document)
        with self._database.write("commit_result") as session:
            stage_store.add_result(session, stage.digest, document, result, execution)
            append_to_all(session, run_ids, events_of(stage, result))
            if attempt.lease is not None:
                task_store.finish(session, stage.digest, attempt.lease)

    def note(self, stage: Stage, so_far: SoFar, run_ids: Sequence[str]) -> None:
        with self._database.write("note_checkpoint") as session:
            steps = so_far.values["curve"][-1]["steps"]
            stage_store.note_checkpoint(session, stage.digest, steps, so_far.blobs["policy"])
            append_to_all(session, run_ids, learning_curve(stage.digest, so_far.values))


def append_to_all(session: Session, run_ids: Sequence[str], events: Sequence[RunEvent]) -> None:
    """Put events on the record of runs, inside a transaction."""
    for run_id in run_ids:
        if run_store.exists(session, run_id):  # it may have been deleted meanwhile
            run_store.append_all(session, run_id, events)


def _role(stage: Stage) -> str:
    return KINDS[stage.kind].role
