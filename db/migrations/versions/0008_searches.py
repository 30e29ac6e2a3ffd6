"""stored specs name DROPO's search, and the SimOpt that keeps the shape of its covariance"""

import json
from collections.abc import Callable
from typing import Any

import sqlalchemy as sa
from alembic import op

revision = "0008"
down_revision = "0007"
branch_labels = None
depends_on = None

# until then guided policy search's, where a benchmark did not say otherwise
_DAMPING = 2.0


def upgrade() -> None:
    _rewrite("runs", lambda spec: _of_run(spec, _searching))
    _rewrite("benchmarks", lambda spec: _of_benchmark(spec, _kept))


def downgrade() -> None:
    """The version before cannot read runs of a SimOpt without damping."""
    _rewrite("runs", lambda spec: _of_run(spec, _exact))
    _rewrite("benchmarks", lambda spec: _of_benchmark(spec, _exact))


def _of_run(spec: dict[str, Any], change: Callable[[Any], Any]) -> dict[str, Any]:
    return {**spec, "method": change(spec["method"])} if "method" in spec else spec


def _of_benchmark(spec: dict[str, Any], change: Callable[[Any], Any]) -> dict[str, Any]:
    return {**spec, "methods": [change(method) for method in spec["methods"]]}


def _kept(method: Any) -> Any:
    """A benchmark's method, whose SimOpt means what it meant, also when it is extended."""
    settings = {"name": method} if isinstance(method, str) else method
    if settings["name"] in ("simopt", "simopt_1"):
        return {"covariance_damping": _DAMPING, **settings}
    return _searching(method)


def _searching(method: Any) -> Any:
    """DROPO's `exact` was a choice of the search; the emulated one is gone."""
    if not _is_dropo(method) or "exact" not in method:
        return method
    others = {name: value for name, value in method.items() if name != "exact"}
    return {**others, "search": "cma_es" if method["exact"] else "trust_region"}


def _exact(method: Any) -> Any:
    if not _is_dropo(method) or "search" not in method:
        return method
    others = {name: value for name, value in method.items() if name != "search"}
    return {**others, "exact": method["search"] == "cma_es"}


def _is_dropo(method: Any) -> bool:
    return isinstance(method, dict) and method["name"] == "dropo"


def _rewrite(table: str, change: Callable[[dict[str, Any]], dict[str, Any]]) -> None:
    rows = sa.table(table, sa.column("number", sa.Integer), sa.column("spec", sa.Text))
    connection = op.get_bind()
    for number, text in connection.execute(sa.select(rows.c.number, rows.c.spec)).all():
        spec = json.loads(text)
        if (changed := change(spec)) != spec:
            new = json.dumps(changed, separators=(",", ":"), ensure_ascii=False)
            connection.execute(rows.update().where(rows.c.number == number).values(spec=new))
