"""stored specs of BayRn report the policy that it believes best, as they did"""

import json
from collections.abc import Callable
from typing import Any

import sqlalchemy as sa
from alembic import op

revision = "0009"
down_revision = "0008"
branch_labels = None
depends_on = None


def upgrade() -> None:
    _rewrite("runs", lambda spec: _of_run(spec, _best))
    _rewrite("benchmarks", lambda spec: _of_benchmark(spec, _best))


def downgrade() -> None:
    """In the version before, BayRn reports the best policy, and nothing else."""
    _rewrite("runs", lambda spec: _of_run(spec, _unsaid))
    _rewrite("benchmarks", lambda spec: _of_benchmark(spec, _unsaid))


def _of_run(spec: dict[str, Any], change: Callable[[Any], Any]) -> dict[str, Any]:
    return {**spec, "method": change(spec["method"])} if "method" in spec else spec


def _of_benchmark(spec: dict[str, Any], change: Callable[[Any], Any]) -> dict[str, Any]:
    return {**spec, "methods": [change(method) for method in spec["methods"]]}


def _best(method: Any) -> Any:
    settings = {"name": method} if isinstance(method, str) else method
    return {"report": "best", **settings} if settings["name"] == "bayrn" else method


def _unsaid(method: Any) -> Any:
    if not isinstance(method, dict) or method["name"] != "bayrn":
        return method
    return {name: value for name, value in method.items() if name != "report"}


def _rewrite(table: str, change: Callable[[dict[str, Any]], dict[str, Any]]) -> None:
    rows = sa.table(table, sa.column("number", sa.Integer), sa.column("spec", sa.Text))
    connection = op.get_bind()
    for number, text in connection.execute(sa.select(rows.c.number, rows.c.spec)).all():
        spec = json.loads(text)
        if (changed := change(spec)) != spec:
            new = json.dumps(changed, separators=(",", ":"), ensure_ascii=False)
            connection.execute(rows.update().where(rows.c.number == number).values(spec=new))
