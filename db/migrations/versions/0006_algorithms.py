"""trainings name their algorithm, which was SAC while there was no other"""

import json
from collections.abc import Callable
from typing import Any

import sqlalchemy as sa
from alembic import op

revision = "0006"
down_revision = "0005"
branch_labels = None
depends_on = None

# of the preset "quick" until then; benchmarks store only what differs from their preset
_QUICK = {
    "algorithm": "sac",
    "max_steps": 120_000,
    "gradient_steps": 12,
    "learning_rate": 0.001,
    "hidden": [128, 128],
    "activation": "relu",
    "batch_size": 128,
    "learning_starts": 2000,
    "evaluate_every": 5000,
    "evaluation_episodes": 24,
}


def upgrade() -> None:
    def named(spec: dict[str, Any]) -> dict[str, Any]:
        return {**spec, "training": {"algorithm": "sac", **spec["training"]}}

    def with_quick(spec: dict[str, Any]) -> dict[str, Any]:
        if spec.get("preset", "quick") != "quick":
            return spec
        return {**spec, "training": _QUICK | (spec.get("training") or {})}

    _rewrite("runs", lambda spec: named(spec) if "training" in spec else spec)
    _rewrite("benchmarks", with_quick)


def downgrade() -> None:
    def unnamed(spec: dict[str, Any]) -> dict[str, Any]:
        training = spec.get("training") or {}
        if training.get("algorithm") != "sac":
            return spec
        return {**spec, "training": {k: v for k, v in training.items() if k != "algorithm"}}

    for table in ("runs", "benchmarks"):
        _rewrite(table, unnamed)


def _rewrite(table: str, change: Callable[[dict[str, Any]], dict[str, Any]]) -> None:
    rows = sa.table(table, sa.column("number", sa.Integer), sa.column("spec", sa.Text))
    connection = op.get_bind()
    for number, text in connection.execute(sa.select(rows.c.number, rows.c.spec)).all():
        spec = json.loads(text)
        if (changed := change(spec)) != spec:
            new = json.dumps(changed, separators=(",", ":"), ensure_ascii=False)
            connection.execute(rows.update().where(rows.c.number == number).values(spec=new))
