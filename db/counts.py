"""Numbers of runs, stages and visits, for monitoring; one transaction."""

from dataclasses import dataclass
from datetime import datetime

from sqlalchemy import func, select

from db.models import RunRow, StageRow, TargetTaskRow, VisitState
from db.session import Database


@dataclass(frozen=True)
class Counts:
    """Numbers of rows at one moment."""

    runs: dict[str, int]  # by state
    stages: dict[str, int]  # that have a result, by kind
    visits: dict[tuple[str, bool], int]  # by state, and True for robots
    claims: list[tuple[str, str, datetime]]  # of robots: visit, worker, since


def count(database: Database) -> Counts:
    """Count everything that the monitoring page shows."""
    visit = TargetTaskRow
    with database.read() as session:
        runs = session.execute(select(RunRow.state, func.count()).group_by(RunRow.state))
        stages = session.execute(select(StageRow.kind, func.count()).group_by(StageRow.kind))
        visits = session.execute(
            select(visit.state, visit.external, func.count()).group_by(visit.state, visit.external)
        )
        claims = session.execute(
            select(visit.id, visit.worker, visit.claimed_at).where(
                visit.external, visit.state == VisitState.CLAIMED
            )
        )
        return Counts(
            dict(runs.all()),
            dict(stages.all()),
            {(state, external): number for state, external, number in visits},
            [(id, str(worker), since) for id, worker, since in claims if since is not None],
        )
