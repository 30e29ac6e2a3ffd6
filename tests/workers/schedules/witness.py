"""The ledger as the dispatcher sees it: faults come between them, and what must hold is checked."""

from collections.abc import Callable, Sequence
from typing import TypeVar

from adr_service.progress import Checkpoint
from adr_service.stages.base import AnyStage, StageResult
from db.errors import DatabaseUnavailable
from tests.workers.schedules.faults import Faults, ServiceDied, Violation
from tests.workers.schedules.ledgers import Ledger
from tests.workers.schedules.simulated_ray import SimulatedRay, result_of
from workers.results import Beginning, Outcome

T = TypeVar("T")


class Witness:
    """The `Results` of the dispatcher."""

    def __init__(self, ledger: Ledger, ray: SimulatedRay, faults: Faults):
        self._ledger, self._ray, self._faults = ledger, ray, faults
        self.is_away = False  # the database
        self.stored: dict[str, tuple[int, float] | None] = {}  # (attempt, began); None: a robot's
        self.asked: dict[str, set[str]] = {}  # by digest, the runs that ever asked
        self.refused: set[str] = set()  # digests whose result the database has refused
        self.commits = 0  # results stored
        self.batches = 0  # transactions that stored several
        self._unstorable: set[tuple[int, float]] = set()  # origins of refused results

    def find(self, stage: AnyStage, run_id: str) -> StageResult | None:
        self.asked.setdefault(stage.digest, set()).add(run_id)
        return self._transaction(lambda: self._ledger.find(stage, run_id))

    def begin(self, beginnings: Sequence[Beginning]) -> list[str | None]:
        for beginning in beginnings:
            if beginning.stage.digest in self.stored:
                kind = beginning.stage.kind
                raise Violation(f"{kind} is computed again though its result is stored")
        if all(beginning.stage.role != "target" for beginning in beginnings):
            return self._ledger.begin(beginnings)  # which writes nothing
        return self._transaction(lambda: self._ledger.begin(beginnings))

    def drop(self, stage: AnyStage) -> None:
        self._transaction(lambda: self._ledger.drop(stage))

    def note(self, stage: AnyStage, checkpoint: Checkpoint, run_ids: Sequence[str]) -> None:
        self._transaction(lambda: self._ledger.note(stage, checkpoint, run_ids))

    def commit(self, outcomes: Sequence[Outcome]) -> list[StageResult]:
        origins = {o.stage.digest: (o.execution.attempt, o.execution.began) for o in outcomes}
        for outcome in outcomes:
            self._check(outcome, origins[outcome.stage.digest])
            if self._faults.happens("database refuses a result"):
                self.refused.add(outcome.stage.digest)
                self._unstorable.add(origins[outcome.stage.digest])
        if not self._unstorable.isdisjoint(origins.values()):
            raise OSError("as the schedule has it")

        def store() -> list[StageResult]:
            stored = self._ledger.commit(outcomes)
            self.commits += len(origins.keys() - self.stored.keys())
            self.batches += len(outcomes) > 1
            self.stored |= origins
            return stored

        return self._transaction(store)

    def _check(self, outcome: Outcome, origin: tuple[int, float]) -> None:
        stage = outcome.stage
        if outcome.result != result_of(stage):
            raise Violation(f"a result of another stage is stored for {stage.kind}")
        if self.stored.get(stage.digest, origin) != origin:
            raise Violation(f"{stage.kind} is committed twice, from two computations")

    def _transaction(self, action: Callable[[], T]) -> T:
        """Do it, unless the database or the service fails before; both may fail after as well."""
        if self.is_away:
            raise DatabaseUnavailable("as the schedule has it")
        dies = self._faults.happens("service dies in a transaction")
        if dies and self._faults.rng.random() < 0.5:
            raise ServiceDied
        done = action()
        if dies:
            raise ServiceDied
        if self._faults.happens("database goes away before its answer"):
            raise DatabaseUnavailable("as the schedule has it, though all is stored")
        return done
