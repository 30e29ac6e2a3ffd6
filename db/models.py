"""The tables. Constraints forbid rows that could not have happened."""

from collections.abc import Iterable, Mapping
from datetime import UTC, datetime
from enum import StrEnum
from typing import TypeVar

from sqlalchemy import (
    CheckConstraint,
    DateTime,
    ForeignKey,
    Index,
    LargeBinary,
    MetaData,
    String,
    Text,
    UniqueConstraint,
    select,
)
from sqlalchemy.engine import Dialect
from sqlalchemy.orm import DeclarativeBase, Mapped, Session, mapped_column
from sqlalchemy.types import TypeDecorator

from adr_service.events import RunState
from db.errors import NotFound

R = TypeVar("R", bound="Base")


class VisitState(StrEnum):
    """State of a visit to a target (`target_tasks.state`)."""

    PENDING = "pending"  # any claimant may have it
    CLAIMED = "claimed"  # a claimant has it under a lease
    DONE = "done"  # its stage has a result
    FAILED = "failed"  # a robot's client reported that no robot can do it
    WITHDRAWN = "withdrawn"  # its run has ended without it

    @property
    def is_finished(self) -> bool:
        """True if nobody may claim or complete the visit, unless its run asks for it again."""
        return self not in OPEN_VISIT


LONGEST_CODE = 80  # of an error
OPEN_VISIT = (VisitState.PENDING, VisitState.CLAIMED)


def _one_of(states: Iterable[StrEnum]) -> str:
    """The SQL condition that the column `state` has one of these values."""
    values = ", ".join(f"'{state.value}'" for state in states)
    return f"state IN ({values})"


class Utc(TypeDecorator[datetime]):
    """Timezone-aware UTC times; SQLite itself forgets the zone."""

    impl = DateTime(timezone=True)
    cache_ok = True

    def process_bind_param(self, value: datetime | None, dialect: Dialect) -> datetime | None:
        return value.astimezone(UTC) if value else None

    def process_result_value(self, value: datetime | None, dialect: Dialect) -> datetime | None:
        if value is None:
            return None
        return value.astimezone(UTC) if value.tzinfo else value.replace(tzinfo=UTC)


class Base(DeclarativeBase):
    """The tables, with names for all their constraints."""

    metadata = MetaData(
        naming_convention={
            "ix": "ix_%(table_name)s_%(column_0_N_name)s",
            "uq": "uq_%(table_name)s_%(column_0_N_name)s",
            "ck": "ck_%(table_name)s_%(constraint_name)s",
            "fk": "fk_%(table_name)s_%(column_0_N_name)s",
            "pk": "pk_%(table_name)s",
        }
    )


class BenchmarkRow(Base):
    """A submitted benchmark; its runs point here."""

    __tablename__ = "benchmarks"

    number: Mapped[int] = mapped_column(primary_key=True)  # order of submission
    id: Mapped[str] = mapped_column(String(40), unique=True)
    created_at: Mapped[datetime] = mapped_column(Utc)
    spec: Mapped[str] = mapped_column(Text)


class RunRow(Base):
    """A submitted run. `state` is the fold of its events, written with them."""

    __tablename__ = "runs"
    __table_args__ = (
        CheckConstraint(_one_of(RunState), name="state"),
        CheckConstraint("submission >= 1", name="submission"),
        CheckConstraint("(state = 'failed') = (error_code IS NOT NULL)", name="error_iff_failed"),
        Index(None, "state"),
        Index(None, "benchmark_id"),
        Index(None, "dataset_id"),
        Index(None, "task", "method"),
    )

    number: Mapped[int] = mapped_column(primary_key=True)  # order of submission
    id: Mapped[str] = mapped_column(String(40), unique=True)
    benchmark_id: Mapped[str | None] = mapped_column(ForeignKey("benchmarks.id"))
    dataset_id: Mapped[str | None] = mapped_column(ForeignKey("datasets.id"))  # it learns from
    created_at: Mapped[datetime] = mapped_column(Utc)
    updated_at: Mapped[datetime] = mapped_column(Utc)
    task: Mapped[str] = mapped_column(String(80))
    variant: Mapped[str] = mapped_column(String(80))
    method: Mapped[str] = mapped_column(String(80))
    seed: Mapped[int]
    spec: Mapped[str] = mapped_column(Text)
    state: Mapped[str] = mapped_column(String(20))
    submission: Mapped[int]  # times it was submitted: 1 + resumes
    cancel_requested: Mapped[bool]
    error_code: Mapped[str | None] = mapped_column(String(LONGEST_CODE))
    error_message: Mapped[str | None] = mapped_column(Text)


class EventRow(Base):
    """One event of a run, written once."""

    __tablename__ = "events"
    __table_args__ = (
        UniqueConstraint("run_id", "key"),
        Index(None, "key"),
        Index(None, "run_id", "type"),
    )

    run_id: Mapped[str] = mapped_column(ForeignKey("runs.id", ondelete="CASCADE"), primary_key=True)
    seq: Mapped[int] = mapped_column(primary_key=True)  # 1, 2, … within the run
    key: Mapped[str] = mapped_column(String(120))
    type: Mapped[str] = mapped_column(String(40))
    body: Mapped[str] = mapped_column(Text)
    created_at: Mapped[datetime] = mapped_column(Utc)


class StageRow(Base):
    """A stage that has a result. There is no row for one that has none."""

    __tablename__ = "stages"
    __table_args__ = (CheckConstraint("attempt >= 1", name="attempt"),)

    digest: Mapped[str] = mapped_column(String(64), primary_key=True)
    kind: Mapped[str] = mapped_column(String(40), index=True)
    document: Mapped[str] = mapped_column(Text)  # canonical JSON that the digest is of
    result: Mapped[str] = mapped_column(Text)  # its JSON values
    attempt: Mapped[int]
    started_by: Mapped[str] = mapped_column(String(40))  # run id; the run may be deleted since
    seconds: Mapped[float]
    timing: Mapped[str | None] = mapped_column(Text)  # JSON; NULL: stored before it was measured
    provenance: Mapped[str] = mapped_column(Text)
    created_at: Mapped[datetime] = mapped_column(Utc)


class ArtifactRow(Base):
    """Immutable bytes by their SHA-256."""

    __tablename__ = "artifacts"

    sha256: Mapped[str] = mapped_column(String(64), primary_key=True)
    size: Mapped[int]
    content: Mapped[bytes] = mapped_column(LargeBinary)


class ImportedStageRow(Base):
    """A stage whose result came by an archive: another cluster's cores computed it."""

    __tablename__ = "imported_stages"

    digest: Mapped[str] = mapped_column(
        ForeignKey("stages.digest", ondelete="CASCADE"), primary_key=True
    )


class CheckpointRow(Base):
    """The best policy so far of a training that has no result yet."""

    __tablename__ = "checkpoints"

    digest: Mapped[str] = mapped_column(String(64), primary_key=True)  # of the stage to be
    steps: Mapped[int]  # of training, after which this was the best policy
    sha256: Mapped[str] = mapped_column(ForeignKey("artifacts.sha256"), index=True)


class DatasetRow(Base):
    """An uploaded recording; its bytes are an artifact."""

    __tablename__ = "datasets"

    number: Mapped[int] = mapped_column(primary_key=True)  # order of upload
    id: Mapped[str] = mapped_column(String(40), unique=True)
    sha256: Mapped[str] = mapped_column(ForeignKey("artifacts.sha256"), index=True)
    created_at: Mapped[datetime] = mapped_column(Utc)
    transitions: Mapped[int]
    episodes: Mapped[int]
    actions: Mapped[int]  # their dimension
    dt: Mapped[float]  # control period [s]
    columns: Mapped[str] = mapped_column(Text)  # JSON list
    origin: Mapped[str] = mapped_column(Text)


class TargetTaskRow(Base):
    """A stage's visit to the target, and its claimant: a robot's client or the simulated target.

    While it is claimed it has a lease, whose token the claimant sends with every request; another
    claim has another token. Once it is done, the stage has the result of the last lease.
    """

    __tablename__ = "target_tasks"
    __table_args__ = (
        CheckConstraint(_one_of(VisitState), name="state"),
        CheckConstraint("(state = 'claimed') = (expires_at IS NOT NULL)", name="lease_iff_claimed"),
        CheckConstraint("(state = 'failed') = (error IS NOT NULL)", name="error_iff_failed"),
        CheckConstraint("attempt >= 0 AND steps >= 0", name="counts"),
        Index(None, "external", "state"),
        Index(None, "state"),
    )

    number: Mapped[int] = mapped_column(primary_key=True)  # order of publication
    id: Mapped[str] = mapped_column(String(40), unique=True)
    digest: Mapped[str] = mapped_column(String(64), unique=True)  # of the stage
    document: Mapped[str] = mapped_column(Text)  # canonical JSON that the digest is of
    run_id: Mapped[str] = mapped_column(String(40), index=True)  # it may be deleted since
    task: Mapped[str] = mapped_column(String(80))
    external: Mapped[bool]  # for robots; else the simulated target's
    state: Mapped[str] = mapped_column(String(20))
    attempt: Mapped[int]  # number of claims
    worker: Mapped[str | None] = mapped_column(String(80))  # the last claimant
    lease: Mapped[str | None] = mapped_column(String(64))  # token of the last claim
    claimed_at: Mapped[datetime | None] = mapped_column(Utc)
    expires_at: Mapped[datetime | None] = mapped_column(Utc)
    steps: Mapped[int]  # of the episode so far, as its claimant reports
    policy_sha256: Mapped[str | None] = mapped_column(ForeignKey("artifacts.sha256"), index=True)
    error: Mapped[str | None] = mapped_column(Text)
    created_at: Mapped[datetime] = mapped_column(Utc)


class ResultsRow(Base):
    """The result table of a run or a benchmark, which takes a while to compute."""

    __tablename__ = "results"

    id: Mapped[str] = mapped_column(String(40), primary_key=True)
    version: Mapped[str] = mapped_column(String(64))  # digest of the rows it was computed from
    body: Mapped[str] = mapped_column(Text)


class RequestRow(Base):
    """A request that created a run or a benchmark, by its Idempotency-Key."""

    __tablename__ = "requests"

    key: Mapped[str] = mapped_column(String(200), primary_key=True)
    request: Mapped[str] = mapped_column(String(64))  # SHA-256
    made: Mapped[str] = mapped_column(String(40))  # id of what it created; it may be deleted since
    created_at: Mapped[datetime] = mapped_column(Utc, index=True)


class StageArtifactRow(Base):
    """A named binary result of a stage."""

    __tablename__ = "stage_artifacts"

    digest: Mapped[str] = mapped_column(
        ForeignKey("stages.digest", ondelete="CASCADE"), primary_key=True
    )
    name: Mapped[str] = mapped_column(String(80), primary_key=True)
    sha256: Mapped[str] = mapped_column(ForeignKey("artifacts.sha256"), index=True)


N = TypeVar("N", BenchmarkRow, DatasetRow, RunRow, TargetTaskRow)  # with an id for users
_KINDS: Mapping[type[Base], str] = {
    BenchmarkRow: "benchmark",
    DatasetRow: "dataset",
    RunRow: "run",
    TargetTaskRow: "target task",
}
NUMBER = "number"  # the column that each database counts for itself


def copy_of(row: R) -> R:
    """A new row with the content of another, for another database."""
    columns = [column.name for column in row.__table__.columns if column.name != NUMBER]
    return type(row)(**{name: getattr(row, name) for name in columns})


def find_row(session: Session, table: type[N], id: str) -> N | None:
    """The row with this id, inside a transaction."""
    return session.scalar(select(table).where(table.id == id))


def get_row(session: Session, table: type[N], id: str) -> N:
    """The row with this id, inside a transaction. Raises NotFound."""
    row = find_row(session, table, id)
    if row is None:
        raise NotFound(_KINDS[table], id)
    return row
