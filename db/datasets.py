"""Uploaded recordings; one function per transaction."""

import json
from collections.abc import Iterable
from datetime import UTC, datetime
from typing import Any

from pydantic import Field
from sqlalchemy import select

from adr_service.criticism.measurements import Measurement
from adr_service.json_values import Wire
from adr_service.transitions import UNKNOWN_ORIGIN, TransitionDataset, dataset_id
from db.errors import NotPossible
from db.models import ArtifactRow, DatasetRow, RunRow, find_row, get_row
from db.references import delete_unreferenced
from db.session import Database
from db.stages import add_artifact

_MEASUREMENT = "measurement"  # the origin of a measurement whose file has no name


class DatasetRecord(Wire):
    """A stored recording."""

    number: int = Field(exclude=True)  # order of upload
    id: str
    sha256: str
    created_at: datetime
    transitions: int
    episodes: int
    actions: int  # their dimension
    dt: float  # control period [s]
    columns: list[str]
    origin: str


def store_dataset(
    database: Database,
    content: bytes,
    data: TransitionDataset | Measurement,
    name: str | None = None,
) -> tuple[DatasetRecord, bool]:
    """Store an `.npz`, given with the data that were parsed from it; True if it is new.

    The file's `name` is the origin of data that say none.
    """
    described, id = _described(data), dataset_id(content)
    if name and described["origin"] in (UNKNOWN_ORIGIN, _MEASUREMENT):
        described["origin"] = name
    with database.write("store_dataset") as session:
        known = find_row(session, DatasetRow, id)
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


def _described(data: TransitionDataset | Measurement) -> dict[str, Any]:
    """The columns of a dataset's row that its data determine."""
    if isinstance(data, Measurement):
        return _of_measurement(data)
    return {
        "transitions": len(data),
        "episodes": data.episode_count,
        "actions": data.actions.shape[1],
        "dt": data.dt,
        "columns": json.dumps(data.columns),
        "origin": data.origin,
    }


def _of_measurement(data: Measurement) -> dict[str, Any]:
    episodes = len(data.spans())
    parts = (("qpos", data.qpos), ("qvel", data.qvel))
    return {
        "transitions": len(data.time) - episodes,
        "episodes": episodes,
        "actions": data.ctrl.shape[1],
        "dt": data.period(),
        "columns": json.dumps([f"{name}_{i}" for name, v in parts for i in range(v.shape[1])]),
        "origin": _MEASUREMENT,
    }


def describe_dataset(database: Database, id: str) -> DatasetRecord:
    """A dataset without its bytes. Raises NotFound."""
    with database.read() as session:
        return _record(get_row(session, DatasetRow, id))


def load_dataset(database: Database, id: str) -> tuple[DatasetRecord, bytes]:
    """A dataset and its `.npz`. Raises NotFound."""
    with database.read() as session:
        row = get_row(session, DatasetRow, id)
        artifact = session.get_one(ArtifactRow, row.sha256)
        return _record(row), artifact.content


def list_datasets(
    database: Database, *, after: int = 0, limit: int = 100, newest_first: bool = False
) -> list[DatasetRecord]:
    """Datasets in order of upload, or the newest first; those numbered above `after`."""
    order = DatasetRow.number.desc() if newest_first else DatasetRow.number
    query = select(DatasetRow).where(DatasetRow.number > after)
    with database.read() as session:
        rows = session.scalars(query.order_by(order).limit(limit))
        return [_record(row) for row in rows]


def origins_of(database: Database, ids: Iterable[str]) -> dict[str, str]:
    """The origins of datasets by their ids."""
    query = select(DatasetRow.id, DatasetRow.origin).where(DatasetRow.id.in_(set(ids)))
    with database.read() as session:
        return {row.id: row.origin for row in session.execute(query)}


def delete_dataset(database: Database, id: str) -> None:
    """Delete a dataset. Raises NotFound, and NotPossible if a run learns from it."""
    with database.write("delete_dataset") as session:
        row = get_row(session, DatasetRow, id)
        run = session.scalar(select(RunRow.id).where(RunRow.dataset_id == id).limit(1))
        if run is not None:
            raise NotPossible(f"run {run} learns from {id}; delete the run first")
        session.delete(row)
        session.flush()
        delete_unreferenced(session)


def _record(row: DatasetRow) -> DatasetRecord:
    own = {name: getattr(row, name) for name in DatasetRecord.model_fields}
    return DatasetRecord(**{**own, "columns": json.loads(row.columns)})
