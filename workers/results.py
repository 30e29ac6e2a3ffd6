"""Results of stages in the database, and what happens if the database cannot be used.

match attempted("the stage could not be looked up", ids, results.find, stage, run_id):
    case Unavailable(): ...         # it passes: try again later (`Retries`)
    case Refused(error): ...        # it does not pass: the stage fails
    case result: ...
"""

import logging
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import ParamSpec, Protocol, TypeVar

from adr_service.benchmark.cost import Execution
from adr_service.json_values import canonical_json
from adr_service.progress import Checkpoint
from adr_service.stages.base import AnyStage, StageResult, events_of
from db import runs as run_store
from db import stages as stage_store
from db import visits as visit_store
from db.errors import DatabaseUnavailable, NotPossible
from db.events import append_to_all
from db.session import RETRY_S, Database

log = logging.getLogger(__name__)
outages = logging.getLogger("workers.outages")  # `api.logs` shows each text once a minute
T = TypeVar("T")
P = ParamSpec("P")
_LEASE_S = 3600.0  # of the simulated target, which is watched by its signs of life


@dataclass(frozen=True)
class Beginning:
    """A stage that a process is about to compute."""

    stage: AnyStage
    run_id: str  # of the run that asked first
    worker: str  # name of the process


@dataclass(frozen=True)
class Outcome:
    """A result that is to be stored."""

    stage: AnyStage
    result: StageResult
    execution: Execution
    lease: str | None  # under which the stage was begun, if it needs one
    run_ids: Sequence[str]  # runs that wait for it


class Results(Protocol):
    """A store of results. Every function may raise DatabaseUnavailable."""

    def find(self, stage: AnyStage, run_id: str) -> StageResult | None:
        """A stored result, to which this run refers from now on as well.

        Without one, a robot's stage is offered to robots. Raises NotPossible if its run has ended,
        as by a robot that could not do the visit: nobody would bring a result.
        """
        ...

    def begin(self, beginnings: Sequence[Beginning]) -> list[str | None]:
        """The leases under which stages are begun, all or none; None for one that needs none."""
        ...

    def drop(self, stage: AnyStage) -> None:
        """Forget the lease of a stage, if it needed one, that led to no result."""
        ...

    def commit(self, outcomes: Sequence[Outcome]) -> list[StageResult]:
        """Store results, and write their events to the runs that waited; all of them or none.

        Return what is stored of each: a result that was there already stays. Raises LeaseLost if
        one of the stages was begun under another lease since.
        """
        ...

    def note(self, stage: AnyStage, checkpoint: Checkpoint, run_ids: Sequence[str]) -> None:
        """Store the checkpoint of a stage that goes on."""
        ...


class DatabaseResults:
    """Results in the service's database; one function per transaction."""

    def __init__(self, database: Database):
        self._database = database

    def find(self, stage: AnyStage, run_id: str) -> StageResult | None:
        with self._database.write("find_result") as session:
            result = stage_store.find_result(session, stage.digest)
            if result is not None:
                append_to_all(session, [run_id], events_of(stage, stage.read(result)))
            elif stage.role == "robot" and run_store.has_ended(session, run_id):
                raise NotPossible(f"{run_id} has ended, and visits no robot")
            elif stage.role == "robot" and visit_store.is_wanted(session, run_id):
                visit_store.publish(session, stage, run_id, datetime.now(UTC))
            return result

    def begin(self, beginnings: Sequence[Beginning]) -> list[str | None]:
        leases: list[str | None] = [None] * len(beginnings)
        visits = [(i, each) for i, each in enumerate(beginnings) if each.stage.role == "target"]
        if visits:
            now = datetime.now(UTC)
            with self._database.write("claim_simulated") as session:
                for index, each in visits:
                    leases[index] = visit_store.claim_simulated(
                        session, each.stage, each.run_id, each.worker, now, _LEASE_S
                    )
        return leases

    def drop(self, stage: AnyStage) -> None:
        if stage.role == "target":
            visit_store.drop_simulated(self._database, stage.digest)

    def commit(self, outcomes: Sequence[Outcome]) -> list[StageResult]:
        stored = list[StageResult]()
        with self._database.write("commit_result") as session:
            for outcome in outcomes:
                stage, document = outcome.stage, canonical_json(outcome.stage.document)
                result = stage_store.add_result(
                    session, stage.digest, document, outcome.result, outcome.execution
                )
                append_to_all(session, outcome.run_ids, events_of(stage, stage.read(result)))
                if outcome.lease is not None:
                    visit_store.finish(session, stage.digest, outcome.lease)
                stored.append(result)
        return stored

    def note(self, stage: AnyStage, checkpoint: Checkpoint, run_ids: Sequence[str]) -> None:
        with self._database.write("note_checkpoint") as session:
            steps, content = checkpoint.steps, checkpoint.content
            stage_store.note_checkpoint(session, stage.digest, steps, content)
            append_to_all(session, run_ids, checkpoint.events)


@dataclass(frozen=True)
class Unavailable:
    """The database cannot be used just now; the same may succeed in `RETRY_S`."""


@dataclass(frozen=True)
class Refused:
    """The database refuses this for good, or has a defect."""

    error: Exception


def attempted(
    trouble: str,
    ids: Mapping[str, str | int],
    action: Callable[P, T],
    *args: P.args,
    **kwargs: P.kwargs,
) -> T | Unavailable | Refused:
    """Call a function that uses the database for one stage; trouble is a value.

    So trouble with one stage stops no other run. `trouble` says in the log what failed, and `ids`
    for which stage.
    """
    try:
        return action(*args, **kwargs)
    except DatabaseUnavailable as error:
        outages.warning("%s just now: %s", trouble, error, extra=dict(ids))
        return Unavailable()
    except NotPossible as error:  # the run has ended meanwhile
        log.info("%s: %s", trouble, error, extra=dict(ids))
        return Refused(error)
    except Exception as error:  # the database's trouble must not stop other runs
        log.exception(trouble, extra=dict(ids))
        return Refused(error)


class Retries:
    """Actions to repeat once the database can be used again, in their order."""

    def __init__(self) -> None:
        self._actions: list[tuple[str | None, Callable[[], None]]] = []
        self._not_before = 0.0

    def add(self, action: Callable[[], None], run_id: str | None = None) -> None:
        """Repeat an action in `RETRY_S`; for a run, if that still wants it then."""
        self._actions.append((run_id, action))
        self._not_before = time.monotonic() + RETRY_S

    def withdraw(self, run_id: str) -> None:
        """Forget the actions for a run."""
        self._actions = [entry for entry in self._actions if entry[0] != run_id]

    def run_due(self, is_stopping: Callable[[], bool] = lambda: False) -> None:
        """Carry out what is due, until the service stops.

        An action that fails again adds itself anew, which ends the round for `RETRY_S`.
        """
        while self._actions and time.monotonic() >= self._not_before and not is_stopping():
            _, action = self._actions.pop(0)
            action()
