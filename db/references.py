"""Deletion of stages, visits and artifacts that nothing refers to any more."""

from sqlalchemy.orm import Session

from db import stages, visits


def delete_unreferenced(session: Session) -> None:
    """Delete what only deleted runs and datasets referred to, inside a transaction.

    Stages that no run's events name, visits that lead to no stage's result, then artifacts that
    no stage, checkpoint, dataset or visit has.
    """
    stages.delete_unmentioned(session)
    visits.delete_abandoned(session)
    stages.delete_unused_artifacts(session)
