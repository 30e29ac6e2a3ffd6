"""stored specs name what were defaults: what BayRn reports, and the budget of DROID"""

import json
from collections.abc import Callable
from typing import Any

import sqlalchemy as sa
from alembic import op

revision = "0009"
down_revision = "0008"
branch_labels = None
depends_on = None

_BUDGETS = {"smoke": 30, "demo": 500, "quick": 500, "fast": 1000, "paper": 1000}


def upgrade() -> None:
    _rewrite("runs", lambda spec: _of_run(spec, _reporting))
    _rewrite("benchmarks", _named)


def downgrade() -> None:
    """In the version before, BayRn reports the best policy, and DROID has a budget."""
    _rewrite("runs", lambda spec: _of_run(spec, _unsaid))
    _rewrite("benchmarks", lambda spec: {**spec, "methods": [_unsaid(m) for m in spec["methods"]]})


def _of_run(spec: dict[str, Any], change: Callable[[Any], Any]) -> dict[str, Any]:
    return {**spec, "method": change(spec["method"])} if "method" in spec else spec


def _named(spec: dict[str, Any]) -> dict[str, Any]:
    """A benchmark whose methods mean what they meant, also when it is extended."""
    droid = {"budget": _BUDGETS[spec.get("preset", "quick")]}
    return {**spec, "methods": [_reporting(_budgeted(m, droid)) for m in spec["methods"]]}


def _reporting(method: Any) -> Any:
    settings = {"name": method} if isinstance(method, str) else method
    return {"report": "best", **settings} if settings["name"] == "bayrn" else method


def _budgeted(method: Any, budget: dict[str, int]) -> Any:
    settings = {"name": method} if isinstance(method, str) else method
    return {**budget, **settings} if settings["name"] == "droid" else method


def _unsaid(method: Any) -> Any:
    if not isinstance(method, dict):
        return method
    return {
        name: value
        for name, value in method.items()
        if name != "report" and (name, value) != ("budget", None)
    }


def _rewrite(table: str, change: Callable[[dict[str, Any]], dict[str, Any]]) -> None:
    rows = sa.table(table, sa.column("number", sa.Integer), sa.column("spec", sa.Text))
    connection = op.get_bind()
    for number, text in connection.execute(sa.select(rows.c.number, rows.c.spec)).all():
        spec = json.loads(text)
        if (changed := change(spec)) != spec:
            new = json.dumps(changed, separators=(",", ":"), ensure_ascii=False)
            connection.execute(rows.update().where(rows.c.number == number).values(spec=new))
