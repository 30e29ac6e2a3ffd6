"""what databases lack that were made by earlier forms of 0004, which grew after it was in use"""

import sqlalchemy as sa
from alembic import op

revision = "0005"
down_revision = "0004"
branch_labels = None
depends_on = None


def upgrade() -> None:
    there = sa.inspect(op.get_bind())
    tables = there.get_table_names()
    if "requests" not in tables:
        op.create_table(
            "requests",
            sa.Column("key", sa.String(length=200), nullable=False),
            sa.Column("request", sa.String(length=64), nullable=False),
            sa.Column("made", sa.String(length=40), nullable=False),
            sa.Column("created_at", sa.DateTime(timezone=True), nullable=False),
            sa.PrimaryKeyConstraint("key", name=op.f("pk_requests")),
        )
        op.create_index(op.f("ix_requests_created_at"), "requests", ["created_at"])
    if "results" not in tables:
        op.create_table(
            "results",
            sa.Column("id", sa.String(length=40), nullable=False),
            sa.Column("version", sa.String(length=64), nullable=False),
            sa.Column("body", sa.Text(), nullable=False),
            sa.PrimaryKeyConstraint("id", name=op.f("pk_results")),
        )
    if "ix_runs_task_method" not in {index["name"] for index in there.get_indexes("runs")}:
        op.create_index(op.f("ix_runs_task_method"), "runs", ["task", "method"])


def downgrade() -> None:
    """0004 as it is now has all of this."""
