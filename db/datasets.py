"""Uploaded recordings; one function per transaction."""

import json
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import Any

from sqlalchemy import select
from sqlalchemy.orm import Session

from adr_service.criticism.measurements import Measurement, is_measurement
from adr_service.transitions import TransitionDataset, dataset_id
from db.errors import NotFound, NotPossible
from db.models import ArtifactRow, DatasetRow, RunRow
from db.session import Database
from db.stages import add_artifact, delete_unreferenced


@dataclass(frozen=True)
class DatasetRecord:
    number: int
    id: str
    sha256: str
    created_at: datetime
    transitions: int
    episodes: int
    actions: int
    dt: float
    columns: list[str]
    origin: str


def store_dataset(database: Database, content: bytes) -> tuple[DatasetRecord, bool]:
    """Store an `.npz` of transitions, or a measurement, and say whether it is new.

    Raises InvalidInput where it is neither.
    """
    described, id = _described(content), dataset_id(content)
    with database.write("store_dataset") as session:
        known = session.scalar(select(DatasetRow).where(DatasetRow.id == id))
        if known is not None:
            return _record(known), False
        row = DatasetRow(
            id=id,
            sha256=add_artifact(session, content),
            created_at=datetime.now(UTC),
            **described,
        )
        session.add(row)
        session.flush()
        return _record(row), True


def _described(content: bytes) -> dict[str, Any]:
    """What is said of a dataset, by column of its table."""
    if is_measurement(content):
        data = Measurement.from_npz(content)
        episodes = len(data.spans())
        parts = (("qpos", data.qpos), ("qvel", data.qvel))
        return {
            "transitions": len(data.time) - episodes,
            "episodes": episodes,
            "actions": data.ctrl.shape[1],
            "dt": data.period(),
            "columns": json.dumps([f"{name}_{i}" for name, v in parts for i in range(v.shape[1])]),
            "origin": "measurement",
        }
    data = TransitionDataset.from_npz(content)
    return {
        "transitions": len(data),
        "episodes": data.episode_count,
        "actions": data.actions.shape[1],
        "dt": data.dt,
        "columns": json.dumps(data.columns),
        "origin": data.origin,
    }


def describe_dataset(database: Database, id: str) -> DatasetRecord:
    """A dataset without its bytes."""
    with database.read() as session:
        return _record(get_dataset(session, id))


def load_dataset(database: Database, id: str) -> tuple[DatasetRecord, bytes]:
    """A dataset and its `.npz`."""
    with database.read() as session:
        row = get_dataset(session, id)
        artifact = session.get_one(ArtifactRow, row.sha256)
        return _record(row), artifact.content


def list_datasets(database: Database, *, after: int = 0, limit: int = 100) -> list[DatasetRecord]:
    """Datasets in order of upload, those numbered above `after`."""
    query = select(DatasetRow).where(DatasetRow.number > after)
    with database.read() as session:
        rows = session.scalars(query.order_by(DatasetRow.number).limit(limit))
        return [_record(row) for row in rows]


def delete_dataset(database: Database, id: str) -> None:
    """Delete a dataset from which no run learns."""
    with database.write("delete_dataset") as session:
        row = get_dataset(session, id)
        run = session.scalar(select(RunRow.id).where(RunRow.dataset_id == id).limit(1))
        if run is not None:
            raise NotPossible(f"run {run} learns from {id}; delete the run first")
        session.delete(row)
        session.flush()
        delete_unreferenced(session)


def get_dataset(session: Session, id: str) -> DatasetRow:
    """A dataset's row, inside a transaction."""
    row = session.scalar(select(DatasetRow).where(DatasetRow.id == id))
    if row is None:
        raise NotFound("dataset", id)
    return row


def _record(row: DatasetRow) -> DatasetRecord:
    return DatasetRecord(
        row.number,
        row.id,
        row.sha256,
        row.created_at,
        row.transitions,
        row.episodes,
        row.actions,
        row.dt,
        json.loads(row.columns),
        row.origin,
    )
