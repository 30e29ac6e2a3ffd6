"""The result table: methods side by side, from the events of their runs."""

import csv
import io
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from itertools import combinations

import numpy as np

from adr_service.arrays import Matrix, Vector
from adr_service.benchmark.statistics import improvement, interquartile_mean, interval, mean
from adr_service.distributions import Distribution, distribution_from_json
from adr_service.events import IterationFinished
from adr_service.methods import INFERRING, METHODS
from adr_service.randomness import stream
from adr_service.specs import RunSpec
from adr_service.target import estimation_error, true_values
from adr_service.tasks.catalogue import get_task, source_of


@dataclass(frozen=True)
class Outcome:
    """One evaluated iteration of one run."""

    spec: RunSpec
    iteration: IterationFinished


@dataclass(frozen=True)
class Row:
    """A method after `iteration` rounds of target data, over all its seeds.

    Returns are undiscounted target returns divided by the task's reward threshold.
    """

    task: str
    variant: str
    method: str
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
    estimation_error: float | None  # RMS of the mean from the truth in [0, 4]; None for UDR, oracle
    reached_threshold: float  # share of policies that did, on their source distribution


@dataclass(frozen=True)
class ParameterEstimate:
    """A method's belief about one parameter after one iteration of one run."""

    task: str
    variant: str
    method: str
    seed: int
    iteration: int
    parameter: str
    unit: str
    mean: float
    std: float
    truth: float


def table(outcomes: Sequence[Outcome]) -> list[Row]:
    """Rows in the order task, variant, method (as catalogued), iteration."""
    groups: dict[tuple[str, str, str, int], list[Outcome]] = {}
    for outcome in outcomes:
        spec = outcome.spec
        key = (spec.task, spec.variant, spec.method.name, outcome.iteration.iteration)
        groups.setdefault(key, []).append(outcome)
    order = {name: position for position, name in enumerate(METHODS)}
    keys = sorted(groups, key=lambda k: (k[0], k[1], order[k[2]], k[3]))
    return [_row(key, sorted(groups[key], key=lambda o: o.spec.seed)) for key in keys]


@dataclass(frozen=True)
class Comparison:
    """How often a policy of one method earns more on the target than one of another."""

    task: str
    variant: str
    method: str
    other: str
    probability: float  # ties counted half
    low: float  # of the 95 % interval
    high: float
    seeds: int  # the fewer of the two


def comparisons(outcomes: Sequence[Outcome]) -> list[Comparison]:
    """Every pair of methods on a task's variant, each after its last common iteration."""
    latest: dict[tuple[str, str], dict[str, list[Outcome]]] = {}
    for outcome in outcomes:
        spec = outcome.spec
        methods = latest.setdefault((spec.task, spec.variant), {})
        kept = methods.setdefault(spec.method.name, [])
        newest = max((o.iteration.iteration for o in kept), default=-1)
        if outcome.iteration.iteration > newest:
            kept.clear()
        if outcome.iteration.iteration >= newest:
            kept.append(outcome)
    found: list[Comparison] = []
    for (task, variant), methods in sorted(latest.items()):
        named = sorted(methods, key=METHODS.index)
        for one, other in combinations(named, 2):
            a, b = (
                _returns(sorted(methods[name], key=lambda o: o.spec.seed)) for name in (one, other)
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
        if spec.method.name not in INFERRING:
            continue
        distribution, truth = _decode(outcome)[0], true_values(spec.task, spec.variant)
        parameters = source_of(spec.task, spec.variant).space.parameters
        found.extend(
            ParameterEstimate(
                spec.task,
                spec.variant,
                spec.method.name,
                spec.seed,
                outcome.iteration.iteration,
                parameter.name,
                parameter.unit,
                float(distribution.mean[i]),
                float(distribution.std[i]),
                truth[parameter.name],
            )
            for i, parameter in enumerate(parameters)
        )
    return found


def to_csv(rows: Sequence[Row]) -> str:
    """The table as CSV with a header; numbers exact."""
    buffer = io.StringIO()
    names = [f.name for f in fields(Row)]
    writer = csv.writer(buffer, lineterminator="\n")
    writer.writerow(names)
    writer.writerows([getattr(row, name) for name in names] for row in rows)
    return buffer.getvalue()


def _row(key: tuple[str, str, str, int], outcomes: Sequence[Outcome]) -> Row:
    task, variant, method, iteration = key
    returns = _returns(outcomes)
    # equal data, equal intervals
    average = interval(returns, mean, stream("interval"))
    middle = interval(returns, interquartile_mean, stream("interval"))
    reached = [flag for o in outcomes for flag in o.iteration.reached_threshold]
    transitions: Vector = np.array([o.iteration.target_transitions for o in outcomes])
    return Row(
        task=task,
        variant=variant,
        method=method,
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
        target_transitions=float(np.mean(transitions)),
        estimation_error=_mean_error(outcomes),
        reached_threshold=float(np.mean(reached)),
    )


def _returns(outcomes: Sequence[Outcome]) -> list[Matrix]:
    """Normalised target returns, (policies, episodes) per seed."""
    return [
        np.array(o.iteration.returns) / get_task(o.spec.task).reward_threshold for o in outcomes
    ]


def _mean_error(outcomes: Sequence[Outcome]) -> float | None:
    errors = [
        estimation_error(o.spec.task, o.spec.variant, _decode(o)[0].mean)
        for o in outcomes
        if o.spec.method.name in (*INFERRING, "prior")
    ]
    return float(np.mean(errors)) if errors else None


def _decode(outcome: Outcome) -> list[Distribution]:
    source = source_of(outcome.spec.task, outcome.spec.variant)
    documents: Sequence[Mapping[str, object]] = outcome.iteration.distributions
    return [distribution_from_json(source.space, dict(document)) for document in documents]
