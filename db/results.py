"""Result tables of runs and benchmarks, kept because their bootstraps take seconds."""

from collections.abc import Sequence

from sqlalchemy import Select, delete
from sqlalchemy.orm import Session

from db.models import BenchmarkRow, ResultsRow, RunRow, find_row
from db.session import Database


def kept_results(database: Database, id: str, version: str) -> str | None:
    """The result table of a run or a benchmark, if it was computed from this version."""
    with database.read() as session:
        row = session.get(ResultsRow, id)
        return row.body if row is not None and row.version == version else None


def keep_results(database: Database, id: str, version: str, body: str) -> None:
    """Store a result table in place of the one before, unless what it is of was deleted since."""
    with database.write("keep_results") as session:
        if find_row(session, RunRow, id) or find_row(session, BenchmarkRow, id):
            session.merge(ResultsRow(id=id, version=version, body=body))


def delete_results(session: Session, ids: Sequence[str] | Select[str]) -> None:
    """Delete the tables of runs or benchmarks, inside a transaction."""
    session.execute(delete(ResultsRow).where(ResultsRow.id.in_(ids)))
