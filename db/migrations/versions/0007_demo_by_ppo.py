"""stored benchmarks of the preset "demo" keep the trainings that it had"""

import json
from typing import Any

import sqlalchemy as sa
from alembic import op

revision = "0007"
down_revision = "0006"
branch_labels = None
depends_on = None

# of the preset "demo" until then; benchmarks store only what differs from their preset
_BUDGET = {"max_steps": 40_000, "evaluate_every": 2500}  # also of another algorithm than SAC
_SAC = {
    **_BUDGET,
    "algorithm": "sac",
    "gradient_steps": 6,
    "hidden": [64, 64],
    "activation": "relu",
    "batch_size": 128,
    "learning_starts": 1000,
    "evaluation_episodes": 24,
}


def upgrade() -> None:
    rows = sa.table("benchmarks", sa.column("number", sa.Integer), sa.column("spec", sa.Text))
    connection = op.get_bind()
    for number, text in connection.execute(sa.select(rows.c.number, rows.c.spec)).all():
        spec = json.loads(text)
        if spec.get("preset") == "demo":
            new = json.dumps(_with_training(spec), separators=(",", ":"), ensure_ascii=False)
            connection.execute(rows.update().where(rows.c.number == number).values(spec=new))


def downgrade() -> None:
    """Leave the trainings in the specs, where they mean the same."""


def _with_training(spec: dict[str, Any]) -> dict[str, Any]:
    given = spec.get("training") or {}
    usual = _SAC if given.get("algorithm", "sac") == "sac" else _BUDGET
    return {**spec, "training": usual | given}
