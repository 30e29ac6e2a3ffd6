"""stored specs keep trainings whose defaults have changed: PPO's weights, and the preset "demo" """

import json
from collections.abc import Callable
from typing import Any

import sqlalchemy as sa
from alembic import op

revision = "0007"
down_revision = "0006"
branch_labels = None
depends_on = None

# of the preset "demo" until then, by algorithm; benchmarks store what differs from their preset
_BUDGET = {"max_steps": 40_000, "evaluate_every": 2500}
_DEMO: dict[str, dict[str, Any]] = {
    "sac": {
        **_BUDGET,
        "algorithm": "sac",
        "gradient_steps": 6,
        "hidden": [64, 64],
        "activation": "relu",
        "batch_size": 128,
        "learning_starts": 1000,
        "evaluation_episodes": 24,
    },
    "crossq": _BUDGET,
    # its defaults, where the preset has other values since
    "ppo": {**_BUDGET, "rollout_steps": 128, "hidden": [128, 128], "learning_rate": 0.0005},
}


def upgrade() -> None:
    _rewrite("runs", _with_first_weights)
    _rewrite("benchmarks", _with_demo)


def downgrade() -> None:
    """Remove what runs did not have; a benchmark's training means the same without its preset."""

    def without(spec: dict[str, Any]) -> dict[str, Any]:
        training = {k: v for k, v in spec.get("training", {}).items() if k != "ortho_init"}
        return {**spec, "training": training} if "training" in spec else spec

    _rewrite("runs", without)


def _with_first_weights(spec: dict[str, Any]) -> dict[str, Any]:
    """PPO's first weights were the library's, and only SB3's were orthogonal."""
    training = spec.get("training", {})
    if training.get("algorithm") != "ppo":
        return spec
    return {**spec, "training": {"ortho_init": training["backend"] == "sb3", **training}}


def _with_demo(spec: dict[str, Any]) -> dict[str, Any]:
    if spec.get("preset") != "demo":
        return spec
    given = spec.get("training") or {}
    return {**spec, "training": _DEMO[given.get("algorithm", "sac")] | given}


def _rewrite(table: str, change: Callable[[dict[str, Any]], dict[str, Any]]) -> None:
    rows = sa.table(table, sa.column("number", sa.Integer), sa.column("spec", sa.Text))
    connection = op.get_bind()
    for number, text in connection.execute(sa.select(rows.c.number, rows.c.spec)).all():
        spec = json.loads(text)
        if (changed := change(spec)) != spec:
            new = json.dumps(changed, separators=(",", ":"), ensure_ascii=False)
            connection.execute(rows.update().where(rows.c.number == number).values(spec=new))
