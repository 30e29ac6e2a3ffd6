"""The ledger as the dispatcher sees it: faults come between them, and what must hold is checked."""

from collections.abc import Callable, Sequence
from typing import TypeVar

from adr_service.benchmark.cost import Execution
from adr_service.progress import Checkpoint
from adr_service.stages.base import AnyStage, StageResult
from db.errors import DatabaseUnavailable
from tests.workers.schedules.faults import Faults, ServiceDied, Violation
from tests.workers.schedules.ledgers import Ledger
from tests.workers.schedules.simulated_ray import SimulatedRay, result_of

T = TypeVar("T")


class Witness:
    """The `Results` of the dispatcher."""

    def __init__(self, ledger: Ledger, ray: SimulatedRay, faults: Faults):
        self._ledger, self._ray, self._faults = ledger, ray, faults
        self.is_away = False  # the database
        self.stored: dict[str, tuple[int, float] | None] = {}  # (attempt, began); None: a robot's
        self.asked: dict[str, set[str]] = {}  # by digest, the runs that ever asked
        self.refused: set[str] = set()  # digests whose result the database has refused
        self.commits = 0

    def find(self, stage: AnyStage, run_id: str) -> StageResult | None:
        self.asked.setdefault(stage.digest, set()).add(run_id)
        return self._transaction(lambda: self._ledger.find(stage, run_id))

    def begin(self, stage: AnyStage, run_id: str, worker: str) -> str | None:
        if stage.digest in self.stored:
            raise Violation(f"{stage.kind} is computed again though its result is stored")
        if stage.role != "target":  # nothing is written
            return None
        return self._transaction(lambda: self._ledger.begin(stage, run_id, worker))

    def drop(self, stage: AnyStage) -> None:
        self._transaction(lambda: self._ledger.drop(stage))

    def note(self, stage: AnyStage, checkpoint: Checkpoint, run_ids: Sequence[str]) -> None:
        self._transaction(lambda: self._ledger.note(stage, checkpoint, run_ids))

    def commit(
        self,
        stage: AnyStage,
        result: StageResult,
        execution: Execution,
        lease: str | None,
        run_ids: Sequence[str],
    ) -> None:
        digest, origin = stage.digest, (execution.attempt, execution.began)
        if result != result_of(stage):
            raise Violation(f"a result of another stage is stored for {stage.kind}")
        if self.stored.get(digest, origin) != origin:
            raise Violation(f"{stage.kind} is committed twice, from two computations")
        if self._faults.happens("database refuses a result"):
            self.refused.add(digest)
            raise OSError("as the schedule has it")

        def store() -> None:
            self._ledger.commit(stage, result, execution, lease, run_ids)
            self.commits += digest not in self.stored
            self.stored[digest] = origin

        self._transaction(store)

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
