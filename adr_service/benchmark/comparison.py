"""The result tables: methods side by side, from the events of their runs."""

import csv
import io
from collections.abc import Mapping, Sequence
from dataclasses import astuple, dataclass, fields
from itertools import combinations
from typing import Any

import numpy as np

from adr_service.arrays import Matrix, Vector
from adr_service.benchmark.statistics import improvement, interquartile_mean, interval, mean
from adr_service.benchmark.truth import estimation_error, true_values
from adr_service.distributions import Distribution, distribution_from_json
from adr_service.events import IterationFinished
from adr_service.methods.catalogue import methods
from adr_service.randomness import stream
from adr_service.specs import RunSpec, SimulatedTarget
from adr_service.tasks.catalogue import get_task, source_of


@dataclass(frozen=True)
class Outcome:
    """One finished iteration of one run."""

    spec: RunSpec
    iteration: IterationFinished
    inference_seconds: float | None = None  # of computing, where that is known


@dataclass(frozen=True)
class Row:
    """A method after `iteration` rounds of target data, over all its seeds.

    Returns are undiscounted target returns divided by the task's reward threshold.
    """

    task: str
    variant: str
    method: str
    collector: str  # whose actions an offline method saw
    iteration: int
    normalised_return: float
    low: float  # of the 95 % interval over seeds, policies and episodes
    high: float
    interquartile_mean: float  # of the policies' mean returns
    interquartile_low: float
    interquartile_high: float
    seeds: int
    policies: int
    episodes: int
    target_rollouts: int  # per seed, what the method could learn from
    target_transitions: float  # per seed, mean
    estimation_error: float | None  # RMS of the mean from the truth in [0, 4], where both are
    posterior_std: float | None  # RMS over the parameters in [0, 4]; the prior's is 1
    reached_threshold: float  # share of policies that did, on their source distribution


@dataclass(frozen=True)
class ParameterEstimate:
    """A method's belief about one parameter after one iteration of one run."""

    task: str
    variant: str
    method: str
    collector: str
    seed: int
    iteration: int
    parameter: str
    unit: str
    mean: float
    std: float
    normalised_std: float  # in [0, 4] coordinates; the prior's is 1
    truth: float | None  # None where the target is not simulated


@dataclass(frozen=True)
class Cost:
    """What one inference cost, mean over seeds."""

    task: str
    variant: str
    method: str
    collector: str
    iteration: int
    seeds: int
    inference_steps: float  # simulated control steps
    inference_seconds: float | None  # on one core; None where it was not measured


def table(outcomes: Sequence[Outcome]) -> list[Row]:
    """Rows in the order task, variant, method (as catalogued), iteration."""
    evaluated = [outcome for outcome in outcomes if outcome.iteration.returns]
    return [_row(key, group) for key, group in _grouped(evaluated).items()]


def costs(outcomes: Sequence[Outcome]) -> list[Cost]:
    """What the inferences cost, in the table's order."""
    inferred = [outcome for outcome in outcomes if outcome.iteration.inferences]
    return [
        Cost(
            *key,
            seeds=len(group),
            inference_steps=float(np.mean([o.iteration.inference_steps for o in group])),
            inference_seconds=_mean([o.inference_seconds for o in group]),
        )
        for key, group in _grouped(inferred).items()
    ]


@dataclass(frozen=True)
class Comparison:
    """How often a policy of one method earns more on the target than one of another."""

    task: str
    variant: str
    method: str  # "dropo on random": of the data-collection study
    other: str
    probability: float  # ties counted half
    low: float  # of the 95 % interval
    high: float
    seeds: int  # the fewer of the two


def comparisons(outcomes: Sequence[Outcome]) -> list[Comparison]:
    """Every pair of methods on a task's variant, each after its last common iteration."""
    latest: dict[tuple[str, str], dict[str, list[Outcome]]] = {}
    for outcome in (outcome for outcome in outcomes if outcome.iteration.returns):
        spec = outcome.spec
        columns = latest.setdefault((spec.task, spec.variant), {})
        kept = columns.setdefault(outcome.spec.column, [])
        newest = max((o.iteration.iteration for o in kept), default=-1)
        if outcome.iteration.iteration > newest:
            kept.clear()
        if outcome.iteration.iteration >= newest:
            kept.append(outcome)
    found: list[Comparison] = []
    order = list(methods())
    for (task, variant), columns in sorted(latest.items()):
        named = sorted(columns, key=lambda name: (order.index(name.split()[0]), name))
        for one, other in combinations(named, 2):
            a, b = (
                returns_of(sorted(columns[name], key=lambda o: o.spec.seed))
                for name in (one, other)
            )
            chance = improvement(a, b, stream("improvement"))
            found.append(
                Comparison(
                    task,
                    variant,
                    one,
                    other,
                    chance.value,
                    chance.low,
                    chance.high,
                    min(len(a), len(b)),
                )
            )
    return found


def estimates(outcomes: Sequence[Outcome]) -> list[ParameterEstimate]:
    """Beliefs of the methods that infer one distribution, parameter by parameter."""
    found: list[ParameterEstimate] = []
    for outcome in outcomes:
        spec = outcome.spec
        if not spec.method.infers:
            continue
        distribution, space = decode(outcome)[0], source_of(spec.task, spec.variant).space
        truth: Mapping[str, float] = {}
        if isinstance(spec.target, SimulatedTarget):
            truth = true_values(spec.task, spec.variant)
        normalised = _normalised_std(outcome)
        found.extend(
            ParameterEstimate(
                spec.task,
                spec.variant,
                spec.method.name,
                spec.collector,
                spec.seed,
                outcome.iteration.iteration,
                parameter.name,
                parameter.unit,
                float(distribution.mean[i]),
                float(distribution.std[i]),
                float(normalised[i]),
                truth.get(parameter.name),
            )
            for i, parameter in enumerate(space.parameters)
        )
    return found


def to_csv(rows: Sequence[Any], row_type: type = Row) -> str:
    """A table of dataclasses as CSV with a header; numbers exact."""
    buffer = io.StringIO()
    writer = csv.writer(buffer, lineterminator="\n")
    writer.writerow([f.name for f in fields(row_type)])
    writer.writerows(astuple(row) for row in rows)
    return buffer.getvalue()


def returns_of(outcomes: Sequence[Outcome]) -> list[Matrix]:
    """Normalised target returns, (policies, episodes) per outcome."""
    return [
        np.array(o.iteration.returns) / get_task(o.spec.task).reward_threshold for o in outcomes
    ]


_Key = tuple[str, str, str, str, int]  # task, variant, method, collector, iteration


def _grouped(outcomes: Sequence[Outcome]) -> dict[_Key, list[Outcome]]:
    """Outcomes that differ in their seeds alone, by seed; methods as catalogued."""
    groups: dict[_Key, list[Outcome]] = {}
    for outcome in sorted(outcomes, key=lambda o: o.spec.seed):
        spec, iteration = outcome.spec, outcome.iteration.iteration
        key = (spec.task, spec.variant, spec.method.name, spec.collector, iteration)
        groups.setdefault(key, []).append(outcome)
    order = {name: position for position, name in enumerate(methods())}
    return {key: groups[key] for key in sorted(groups, key=lambda k: (*k[:2], order[k[2]], *k[3:]))}


def _mean(values: Sequence[float | None]) -> float | None:
    known = [value for value in values if value is not None]
    return float(np.mean(known)) if known else None


def _row(key: _Key, outcomes: Sequence[Outcome]) -> Row:
    task, variant, method, collector, iteration = key
    returns = returns_of(outcomes)
    # equal data, equal intervals
    average = interval(returns, mean, stream("interval"))
    middle = interval(returns, interquartile_mean, stream("interval"))
    reached = [flag for o in outcomes for flag in o.iteration.reached_threshold]
    return Row(
        task=task,
        variant=variant,
        method=method,
        collector=collector,
        iteration=iteration,
        normalised_return=average.value,
        low=average.low,
        high=average.high,
        interquartile_mean=middle.value,
        interquartile_low=middle.low,
        interquartile_high=middle.high,
        seeds=len(outcomes),
        policies=sum(len(r) for r in returns),
        episodes=sum(r.size for r in returns),
        target_rollouts=max(o.iteration.target_rollouts for o in outcomes),
        target_transitions=float(np.mean([o.iteration.target_transitions for o in outcomes])),
        estimation_error=_mean([_error(o) for o in outcomes]),
        posterior_std=_mean([_spread(o) for o in outcomes]),
        reached_threshold=float(np.mean(reached)),
    )


def _error(outcome: Outcome) -> float | None:
    if not outcome.spec.method.believes:
        return None
    if not isinstance(outcome.spec.target, SimulatedTarget):
        return None  # nobody knows the truth
    return estimation_error(outcome.spec.task, outcome.spec.variant, decode(outcome)[0].mean)


def _spread(outcome: Outcome) -> float | None:
    if not outcome.spec.method.believes:
        return None
    return float(np.sqrt(np.mean(_normalised_std(outcome) ** 2)))


def _normalised_std(outcome: Outcome) -> Vector:
    """Standard deviations (d,) in [0, 4] coordinates."""
    space = source_of(outcome.spec.task, outcome.spec.variant).space
    return decode(outcome)[0].std / (space.high - space.low) * space.WIDTH


def decode(outcome: Outcome) -> list[Distribution]:
    """The distributions that the iteration's policies were trained on."""
    spec = outcome.spec
    # the truth's own space is that of the vanilla source
    variant = "vanilla" if spec.method.needs_truth else spec.variant
    space = source_of(spec.task, variant).space
    return [distribution_from_json(space, given) for given in outcome.iteration.distributions]
