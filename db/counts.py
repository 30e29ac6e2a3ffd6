"""How much there is of everything, for those who watch; one transaction."""

from dataclasses import dataclass
from datetime import datetime

from sqlalchemy import func, select

from db.models import RunRow, StageRow, TargetTaskRow
from db.session import Database


@dataclass(frozen=True)
class Counts:
    runs: dict[str, int]  # by state
    stages: dict[str, int]  # that have a result, by kind
    tasks: dict[tuple[str, bool], int]  # by state, and whether for robots
    claims: list[tuple[str, str, datetime]]  # of robots: task, worker, since


def count(database: Database) -> Counts:
    task = TargetTaskRow
    with database.read() as session:
        runs = session.execute(select(RunRow.state, func.count()).group_by(RunRow.state))
        stages = session.execute(select(StageRow.kind, func.count()).group_by(StageRow.kind))
        tasks = session.execute(
            select(task.state, task.external, func.count()).group_by(task.state, task.external)
        )
        claims = session.execute(
            select(task.id, task.worker, task.claimed_at).where(
                task.external, task.state == "claimed"
            )
        )
        return Counts(
            dict(runs.tuples().all()),
            dict(stages.tuples().all()),
            {(state, external): number for state, external, number in tasks},
            [(id, str(worker), since) for id, worker, since in claims if since is not None],
        )
