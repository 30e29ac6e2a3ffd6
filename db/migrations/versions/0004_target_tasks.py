"""tasks of targets, simulated ones and robots; requests that came with a key; tables"""

import sqlalchemy as sa
from alembic import op

revision = "0004"
down_revision = "0003"
branch_labels = None
depends_on = None


def upgrade() -> None:
    op.create_table(
        "target_tasks",
        sa.Column("number", sa.Integer(), nullable=False),
        sa.Column("id", sa.String(length=40), nullable=False),
        sa.Column("digest", sa.String(length=64), nullable=False),
        sa.Column("document", sa.Text(), nullable=False),
        sa.Column("run_id", sa.String(length=40), nullable=False),
        sa.Column("task", sa.String(length=80), nullable=False),
        sa.Column("external", sa.Boolean(), nullable=False),
        sa.Column("state", sa.String(length=20), nullable=False),
        sa.Column("attempt", sa.Integer(), nullable=False),
        sa.Column("worker", sa.String(length=80), nullable=True),
        sa.Column("lease", sa.String(length=64), nullable=True),
        sa.Column("claimed_at", sa.DateTime(timezone=True), nullable=True),
        sa.Column("expires_at", sa.DateTime(timezone=True), nullable=True),
        sa.Column("steps", sa.Integer(), nullable=False),
        sa.Column("policy_sha256", sa.String(length=64), nullable=True),
        sa.Column("error", sa.Text(), nullable=True),
        sa.Column("created_at", sa.DateTime(timezone=True), nullable=False),
        sa.CheckConstraint(
            "state IN ('pending', 'claimed', 'done', 'failed', 'withdrawn')",
            name=op.f("ck_target_tasks_state"),
        ),
        sa.CheckConstraint(
            "(state = 'claimed') = (expires_at IS NOT NULL)",
            name=op.f("ck_target_tasks_lease_iff_claimed"),
        ),
        sa.CheckConstraint(
            "(state = 'failed') = (error IS NOT NULL)",
            name=op.f("ck_target_tasks_error_iff_failed"),
        ),
        sa.CheckConstraint("attempt >= 0 AND steps >= 0", name=op.f("ck_target_tasks_counts")),
        sa.ForeignKeyConstraint(
            ["policy_sha256"], ["artifacts.sha256"], name=op.f("fk_target_tasks_policy_sha256")
        ),
        sa.PrimaryKeyConstraint("number", name=op.f("pk_target_tasks")),
        sa.UniqueConstraint("digest", name=op.f("uq_target_tasks_digest")),
        sa.UniqueConstraint("id", name=op.f("uq_target_tasks_id")),
    )
    with op.batch_alter_table("target_tasks", schema=None) as batch_op:
        batch_op.create_index(batch_op.f("ix_target_tasks_run_id"), ["run_id"])
        batch_op.create_index(batch_op.f("ix_target_tasks_policy_sha256"), ["policy_sha256"])
        batch_op.create_index(batch_op.f("ix_target_tasks_external_state"), ["external", "state"])

    op.create_table(
        "requests",
        sa.Column("key", sa.String(length=200), nullable=False),
        sa.Column("request", sa.String(length=64), nullable=False),
        sa.Column("made", sa.String(length=40), nullable=False),
        sa.Column("created_at", sa.DateTime(timezone=True), nullable=False),
        sa.PrimaryKeyConstraint("key", name=op.f("pk_requests")),
    )
    op.create_index(op.f("ix_requests_created_at"), "requests", ["created_at"])
    op.create_table(
        "results",
        sa.Column("id", sa.String(length=40), nullable=False),
        sa.Column("version", sa.String(length=64), nullable=False),
        sa.Column("body", sa.Text(), nullable=False),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_results")),
    )
    op.create_index(op.f("ix_runs_task_method"), "runs", ["task", "method"])


def downgrade() -> None:
    op.drop_index(op.f("ix_runs_task_method"), "runs")
    op.drop_table("results")
    op.drop_table("requests")
    op.drop_table("target_tasks")
