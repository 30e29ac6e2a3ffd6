"""indices for lists of target tasks by state, iterations of runs, and numbers of stages"""

from alembic import op

revision = "0011"
down_revision = "0010"
branch_labels = None
depends_on = None


def upgrade() -> None:
    op.create_index(op.f("ix_target_tasks_state"), "target_tasks", ["state"])
    op.create_index(op.f("ix_events_run_id_type"), "events", ["run_id", "type"])
    op.create_index(op.f("ix_stages_kind"), "stages", ["kind"])


def downgrade() -> None:
    op.drop_index(op.f("ix_stages_kind"), "stages")
    op.drop_index(op.f("ix_events_run_id_type"), "events")
    op.drop_index(op.f("ix_target_tasks_state"), "target_tasks")
