"""Probabilities of improvement as matrices, one for each task's variant.

for matrix in improvement_matrices(results["comparisons"]):
    print(matrix.task, matrix.variant, matrix.names, matrix.rows)
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import groupby
from typing import Any

from adr_service.benchmark.statistics import Interval


@dataclass(frozen=True)
class ImprovementMatrix:
    """Methods on one task's variant, each against each."""

    task: str
    variant: str
    names: list[str]
    # by method, the probability that one of its policies earns more than one of each other's
    rows: list[tuple[str, list[Interval | None]]]


def improvement_matrices(comparisons: Sequence[dict[str, Any]]) -> list[ImprovementMatrix]:
    """Matrices of comparisons as `/results` has them, in their order.

    A variant without any interval has none.
    """
    grouped = groupby(comparisons, key=lambda pair: (pair["task"], pair["variant"]))
    by_variant = [(*key, list(pairs)) for key, pairs in grouped]
    return [
        _matrix(task, variant, pairs)
        for task, variant, pairs in by_variant
        if any(pair["low"] is not None for pair in pairs)
    ]


def _matrix(task: str, variant: str, pairs: list[dict[str, Any]]) -> ImprovementMatrix:
    known: dict[tuple[str, str], Interval] = {}
    for pair in pairs:
        value, low, high = pair["probability"], pair["low"], pair["high"]
        known[pair["method"], pair["other"]] = Interval(value, low, high)
        turned = (None, None) if low is None else (1 - high, 1 - low)
        known[pair["other"], pair["method"]] = Interval(1 - value, *turned)
    names = list(dict.fromkeys(name for one_and_other in known for name in one_and_other))
    rows = [(one, [known.get((one, other)) for other in names]) for one in names]
    return ImprovementMatrix(task, variant, names, rows)
