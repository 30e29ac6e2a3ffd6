"""Outcomes of one budget by cell: a method on a task's variant after some iteration."""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

from adr_service.benchmark.comparison import Outcome
from adr_service.benchmark.statistics import FEWEST_SEEDS
from adr_service.methods.catalogue import methods


@dataclass(frozen=True)
class Cell:
    """A method on a task's variant, after `iteration` rounds of data (None: the last)."""

    task: str
    variant: str
    method: str
    iteration: int | None = None
    collector: str = "simopt"

    @property
    def key(self) -> tuple[str, ...]:
        return (self.task, self.variant, self.method, self.collector)

    def __str__(self) -> str:
        after = "" if self.iteration is None else f" after {self.iteration}"
        whose = "" if self.collector == "simopt" else f" on {self.collector} data"
        return f"{self.method}{whose} on {self.task} {self.variant}{after}"


class Measured:
    """The outcomes of one budget, by what was measured; of equal runs, the latest."""

    def __init__(self, outcomes: Sequence[Outcome]):
        self._cells: dict[tuple[str, ...], dict[int, dict[int, Outcome]]] = {}
        for outcome in outcomes:
            spec = outcome.spec
            key = (spec.task, spec.variant, spec.method.name, spec.collector)
            seeds = self._cells.setdefault(key, {})
            seeds.setdefault(spec.seed, {})[outcome.iteration.iteration] = outcome

    def iterations(self, cell: Cell) -> list[int]:
        """Iterations after which every seed of the method was evaluated, or at least three."""
        seeds = self._cells.get(cell.key, {}).values()
        counts = Counter(iteration for found in seeds for iteration in found)
        fewest = min(len(seeds), FEWEST_SEEDS)
        return sorted(iteration for iteration, count in counts.items() if count >= fewest)

    def of(self, cell: Cell) -> dict[int, Outcome]:
        """The outcomes of a cell by seed; none where it was not measured."""
        found = self._cells.get(cell.key, {})
        return {
            seed: iterations[self.resolve(cell)]
            for seed, iterations in sorted(found.items())
            if self.resolve(cell) in iterations
        }

    def resolve(self, cell: Cell) -> int:
        """The iteration that a cell means: the last is the spec's, for methods that iterate."""
        if cell.iteration is not None:
            return cell.iteration
        specs = [o.spec for found in self._cells.get(cell.key, {}).values() for o in found.values()]
        iterates = methods()[cell.method].learns_from != "nothing"
        return specs[0].iterations if specs and iterates else 0
