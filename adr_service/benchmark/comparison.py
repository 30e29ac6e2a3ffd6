"""Result tables: methods side by side, from the events of their runs."""

import csv
import io
from collections import Counter
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import astuple, dataclass, fields
from functools import lru_cache
from itertools import combinations
from typing import Any

import numpy as np

from adr_service.arrays import Matrix
from adr_service.benchmark.statistics import (
    FEWEST_SEEDS,
    Interval,
    bootstrap_interval,
    improvement,
    interquartile_mean,
    mean_interval,
    seed_interval,
)
from adr_service.benchmark.truth import (
    energy_score,
    estimation_error,
    log_score,
    true_values,
)
from adr_service.distributions import Distribution, distribution_from_json, normalised_std
from adr_service.events import IterationFinished
from adr_service.methods.catalogue import methods
from adr_service.randomness import stream
from adr_service.specs import RunSpec, SimulatedTarget
from adr_service.specs.lost import Lost
from adr_service.tasks.catalogue import get_task, hidden_of, source_of


@dataclass(frozen=True)
class Outcome:
    """One finished iteration of one run."""

    spec: RunSpec
    iteration: IterationFinished
    inference_seconds: float | None = None  # of a CPU, if known
    lost: str | None = None  # why its distributions cannot be read here
    has_failed: bool = False  # its run failed, and may never finish another

    @property
    def is_inferred(self) -> bool:
        """True if the method infers one distribution, which can be read here."""
        return self.spec.method.infers and self.lost is None


@dataclass(frozen=True)
class Row:
    """A method after `iteration` rounds of target data, over all its seeds.

    Returns are undiscounted target returns divided by the task's reward threshold.
    """

    task: str
    variant: str
    method: str
    collector: str  # the policy that acted while an offline method's data were recorded
    iteration: int
    normalised_return: float
    low: float | None  # of Student's 95 % interval over seeds; None: fewer than three have none
    high: float | None
    interquartile_mean: float  # of the policies' mean returns
    interquartile_low: float | None  # of the bootstrap over seeds, policies and episodes
    interquartile_high: float | None
    seeds: int
    policies: int
    episodes: int
    target_rollouts: int  # target episodes that the method used, in the seed with most
    target_transitions: float  # per seed, mean
    target_returns: int  # full episodes of a method that sees returns alone; 0 for all others
    inference_steps: float  # per seed, mean; control steps simulated by the iteration's inference
    estimation_error: float | None  # RMS distance of the mean from the truth in [0, 4], if known
    posterior_std: float | None  # RMS over the parameters in [0, 4]; the prior's is 1
    log_score: float | None  # log density of the truth [nat], if it is known, the belief has one,
    # and no seed's belief excludes the truth (minus infinity)
    energy_score: float | None  # of the belief at the truth, in [0, 4]; 0 is best
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
    truth: float | None  # None if the target is not simulated


@dataclass(frozen=True)
class InferenceCost:
    """Cost of one inference, mean over seeds."""

    task: str
    variant: str
    method: str
    collector: str
    iteration: int
    seeds: int
    inference_steps: float  # simulated control steps
    inference_seconds: float | None  # of a CPU, of any type; None if not measured


def table(outcomes: Sequence[Outcome]) -> list[Row]:
    """Rows in the order task, variant, method (as catalogued), iteration."""
    evaluated = [outcome for outcome in outcomes if outcome.iteration.returns]
    return [_row(key, group) for key, group in _grouped(evaluated).items()]


def costs(outcomes: Sequence[Outcome]) -> list[InferenceCost]:
    """Costs of the inferences, in the table's order."""
    inferred = [outcome for outcome in outcomes if outcome.iteration.inferences]
    return [
        InferenceCost(
            *key,
            seeds=len(group),
            inference_steps=float(np.mean([o.iteration.inference_steps for o in group])),
            inference_seconds=_mean([o.inference_seconds for o in group]),
        )
        for key, group in _grouped(inferred).items()
    ]


@dataclass(frozen=True)
class Comparison:
    """One method against another on the target, with the same seeds."""

    task: str
    variant: str
    method: str  # "dropo on random": of the data-collection study
    other: str
    probability: float  # that a policy of the first earns more, ties counted half
    low: float | None  # of the bootstrap over seeds, policies and episodes
    high: float | None
    difference: float  # of the normalised returns, seed by seed
    difference_low: float | None  # of Student's 95 % interval over seeds
    difference_high: float | None
    seeds: int  # that both have
    iteration: int  # the later one of the two; methods that see no target data have 0


def comparisons(outcomes: Sequence[Outcome]) -> list[Comparison]:
    """Every pair of methods on a task's variant, of its `final_outcomes`."""
    order = list(methods())
    compared: list[Comparison] = []
    for (task, variant), columns in sorted(final_outcomes(outcomes).items()):
        ranks = {name: order.index(own[0].spec.method.name) for name, own in columns.items()}
        names = sorted(columns, key=lambda name: (ranks[name], name))
        for one, other in combinations(names, 2):
            sides = [{o.spec.seed: o for o in columns[name]} for name in (one, other)]
            seeds = sorted(sides[0].keys() & sides[1].keys())
            if seeds:
                a, b = ([side[seed] for seed in seeds] for side in sides)
                compared.append(Comparison(task, variant, one, other, *_compared(a, b)))
    return compared


def _compared(
    one: Sequence[Outcome], other: Sequence[Outcome]
) -> tuple[float, float | None, float | None, float, float | None, float | None, int, int]:
    """The numbers of a Comparison, from outcomes of the same seeds."""
    iteration = max(outcome.iteration.iteration for outcome in (one[0], other[0]))
    returns = returns_of(one), returns_of(other)
    policies = policies_of(one), policies_of(other)
    chance = improvement(*returns, stream("improvement"), policies)
    gaps = [a.mean() - b.mean() for a, b in zip(*returns, strict=True)]
    gap = seed_interval(np.array(gaps))
    numbers = (chance.value, chance.low, chance.high, gap.value, gap.low, gap.high)
    return *numbers, len(gaps), iteration


def final_outcomes(
    outcomes: Sequence[Outcome],
) -> dict[tuple[str, str], dict[str, list[Outcome]]]:
    """The evaluated outcomes that are compared, by task and variant, then by column: those after
    the iteration of `last_shared`."""
    places: dict[tuple[str, str], dict[str, list[Outcome]]] = {}
    for outcome in (outcome for outcome in outcomes if outcome.iteration.returns):
        columns = places.setdefault((outcome.spec.task, outcome.spec.variant), {})
        columns.setdefault(outcome.spec.column, []).append(outcome)
    return {
        place: {
            name: [o for o in columns[name] if o.iteration.iteration == number]
            for name, number in _shared(columns).items()
        }
        for place, columns in places.items()
    }


def not_compared(outcomes: Sequence[Outcome]) -> list[str]:
    """Name the evaluated columns that `final_outcomes` leaves out, as "bayrn (hopper noisy)"."""
    final = final_outcomes(outcomes)
    specs = [outcome.spec for outcome in outcomes if outcome.iteration.returns]
    return sorted(
        {
            f"{spec.column} ({spec.task} {spec.variant})"
            for spec in specs
            if spec.column not in final[spec.task, spec.variant]
        }
    )


def _shared(columns: Mapping[str, Sequence[Outcome]]) -> dict[str, int]:
    """The iteration of `last_shared`, without the runs that have failed, unless all that learn
    have."""
    specs = {name: found[0].spec for name, found in columns.items()}
    without_data = {name for name, spec in specs.items() if spec.method.learns_from == "nothing"}
    counted = {
        name: [o for o in found if name in without_data or not o.has_failed]
        for name, found in columns.items()
    }
    if not any(found for name, found in counted.items() if name not in without_data):
        counted = columns
    seeds = {
        name: Counter(outcome.iteration.iteration for outcome in found)
        for name, found in counted.items()
        if found
    }
    return last_shared(seeds, without_data, max(spec.iterations for spec in specs.values()))


def last_shared(
    seeds: Mapping[str, Mapping[int, int]], without_data: Collection[str], planned: int
) -> dict[str, int]:
    """The iteration after which each column is compared; columns not compared are absent.

    Once two learning columns (or the only one) have the planned iteration for all their seeds, or
    for as many as an interval needs, they are compared after it, and others join as they finish.
    Before that, columns are compared after the last iteration that all their seeds have, so that
    an unfinished benchmark compares equal amounts of data.

    `seeds`: by column, the number of seeds that have each iteration; seeds without any do not
    count. `without_data`: the columns of methods that learn from no target data.
    """
    compared = {column: max(seeds[column]) for column in seeds if column in without_data}
    learning = {column: counts for column, counts in seeds.items() if column not in without_data}
    finished = [
        column
        for column, counts in learning.items()
        if counts.get(planned, 0) >= min(FEWEST_SEEDS, max(counts.values()))
    ]
    if len(finished) > 1 or (finished and len(learning) == 1):
        return compared | dict.fromkeys(finished, planned)
    shared = min(map(_last_of_all, learning.values()), default=0)
    return compared | {column: shared for column, counts in learning.items() if shared in counts}


def _last_of_all(counts: Mapping[int, int]) -> int:
    """The last iteration that all seeds have."""
    return max(number for number, count in counts.items() if count == max(counts.values()))


def estimates(outcomes: Sequence[Outcome]) -> list[ParameterEstimate]:
    """Beliefs of the methods that infer one distribution, parameter by parameter."""
    inferred = [outcome for outcome in outcomes if outcome.is_inferred]
    return [estimate for outcome in inferred for estimate in _estimates(outcome)]


def lost(outcomes: Sequence[Outcome]) -> list[str]:
    """The tasks with distributions that cannot be read here, each with the reason."""
    return sorted({f"{o.spec.task}: {o.lost}" for o in outcomes if o.lost is not None})


def _estimates(outcome: Outcome) -> list[ParameterEstimate]:
    spec, distribution = outcome.spec, decode(outcome)[0]
    truth: Mapping[str, float] = {}
    if isinstance(spec.target, SimulatedTarget):
        truth = true_values(spec.task, spec.variant)
    normalised = normalised_std(distribution)
    return [
        ParameterEstimate(
            task=spec.task,
            variant=spec.variant,
            method=spec.method.name,
            collector=spec.collector,
            seed=spec.seed,
            iteration=outcome.iteration.iteration,
            parameter=parameter.name,
            unit=parameter.unit,
            mean=float(distribution.mean[i]),
            std=float(distribution.std[i]),
            normalised_std=float(normalised[i]),
            truth=truth.get(parameter.name),
        )
        for i, parameter in enumerate(distribution.space.parameters)
    ]


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


Policies = tuple[tuple[str, ...], ...]  # SHA-256 of the policies of each seed


def policies_of(outcomes: Sequence[Outcome]) -> Policies:
    """The policies that were evaluated, per outcome."""
    return tuple(tuple(outcome.iteration.policies) for outcome in outcomes)


_Key = tuple[str, str, str, str, int]  # task, variant, method, collector, iteration


def _grouped(outcomes: Sequence[Outcome]) -> dict[_Key, list[Outcome]]:
    """Outcomes grouped by all but their seed, in order of seeds; methods as catalogued."""
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


def _finite(value: float | None) -> float | None:
    return value if value is not None and np.isfinite(value) else None


def _row(key: _Key, outcomes: Sequence[Outcome]) -> Row:
    task, variant, method, collector, iteration = key
    returns = returns_of(outcomes)
    # the same stream for all rows, so that equal data have equal intervals
    average = mean_interval(returns)
    middle = _middle(tuple((each.shape, each.tobytes()) for each in returns))
    reached = [flag for o in outcomes for flag in o.iteration.reached_threshold]
    rollouts = max(o.iteration.target_rollouts for o in outcomes)
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
        target_rollouts=rollouts,
        target_transitions=float(np.mean([o.iteration.target_transitions for o in outcomes])),
        target_returns=rollouts if methods()[method].learns_from == "returns" else 0,
        inference_steps=float(np.mean([o.iteration.inference_steps for o in outcomes])),
        estimation_error=_mean([_error(o) for o in outcomes]),
        posterior_std=_mean([_spread(o) for o in outcomes]),
        log_score=_finite(_mean([_scored(o, log_score) for o in outcomes])),
        energy_score=_mean([_scored(o, energy_score) for o in outcomes]),
        reached_threshold=float(np.mean(reached)),
    )


@lru_cache(maxsize=512)
def _middle(returns: tuple[tuple[tuple[int, ...], bytes], ...]) -> Interval:
    """Interquartile mean of returns, given as shapes and bytes by seed; kept, because a page that
    is open asks again for all rows while a few of them change."""
    seeds = [np.frombuffer(content).reshape(shape) for shape, content in returns]
    return bootstrap_interval(seeds, interquartile_mean, stream("interval"))


def _error(outcome: Outcome) -> float | None:
    return _scored(outcome, lambda task, variant, d: estimation_error(task, variant, d.mean))


def _scored(
    outcome: Outcome, score: Callable[[str, str, Distribution], float | None]
) -> float | None:
    """A score of a method's belief at the hidden truth; None without a belief or a known truth."""
    spec = outcome.spec
    if not _is_belief(outcome) or not isinstance(spec.target, SimulatedTarget):
        return None
    return score(spec.task, spec.variant, decode(outcome)[0])


def _spread(outcome: Outcome) -> float | None:
    if not _is_belief(outcome):
        return None
    return float(np.sqrt(np.mean(normalised_std(decode(outcome)[0]) ** 2)))


def _is_belief(outcome: Outcome) -> bool:
    return outcome.spec.method.believes and outcome.lost is None


def decode(outcome: Outcome) -> list[Distribution]:
    """The beliefs that the iteration's policies were trained on, before any rounding.

    The oracle's is the point that it trained on, after rounding. Raises Lost if they were computed
    with another version of the task's package.
    """
    if outcome.lost is not None:
        raise Lost(outcome.lost)
    spec = outcome.spec
    source = source_of(spec.task, spec.variant)
    if spec.method.needs_truth:
        source = hidden_of(spec.task, spec.variant).source
    space = source.space
    return [distribution_from_json(space, given) for given in outcome.iteration.distributions]
