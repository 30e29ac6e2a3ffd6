"""States in the tables' constraints."""

from sqlalchemy import CheckConstraint

from db.models import RunRow, TargetTaskRow, VisitState


def condition(row, name):
    """The SQL text of a table's CHECK constraint."""
    checks = [c for c in row.__table__.constraints if isinstance(c, CheckConstraint)]
    return next(str(c.sqltext) for c in checks if c.name.endswith(name))


def test_the_constraints_are_those_of_the_migrations():
    """Alembic does not compare them."""
    assert condition(RunRow, "_state") == (
        "state IN ('queued', 'running', 'succeeded', 'failed', 'cancelled')"
    )
    assert condition(TargetTaskRow, "_state") == (
        "state IN ('pending', 'claimed', 'done', 'failed', 'withdrawn')"
    )


def test_a_visit_is_open_until_it_is_done_failed_or_withdrawn():
    assert {state for state in VisitState if not state.is_finished} == {"pending", "claimed"}
