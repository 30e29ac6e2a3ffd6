"""Outcomes that belong together: of one budget, and of one setting of every method.

for part in by_budget(outcomes):
    changes(part)                   # fields that are not the preset's
"""

from collections import defaultdict
from collections.abc import Callable, Iterable, Sequence
from functools import cache

from pydantic import ValidationError

from adr_service.benchmark.comparison import Outcome
from adr_service.json_values import canonical_json
from adr_service.specs import RunSpec

_UNCHANGED = "{}"  # no change from the preset
_Facts = Callable[[RunSpec], dict[str, object]]


def by_budget(outcomes: Iterable[Outcome]) -> list[list[Outcome]]:
    """The outcomes of each budget, with one setting of every method, in order of their presets.

    A method that learns from what SimOpt collects is with the runs of that SimOpt.
    """
    budgets: dict[tuple[str, str], list[Outcome]] = {}
    for outcome in outcomes:
        spec = outcome.spec
        budgets.setdefault((spec.preset, _changed(spec, _budget)), []).append(outcome)
    return [
        part
        for _, group in sorted(budgets.items())
        for collected in _by_collection(group)
        for part in _by_settings(collected)
    ]


def changes(outcomes: Iterable[Outcome]) -> dict[str, object]:
    """Fields of runs' budgets and methods that are not those of their presets, by name."""
    changed: dict[str, object] = {}
    for spec in (outcome.spec for outcome in outcomes):
        for facts in (_budget, _settings, _collection):
            changed |= _changes_of(spec, facts)
    return changed


def _budget(spec: RunSpec) -> dict[str, object]:
    names = ("iterations", "transitions", "evaluation_episodes", "resolution")
    training = {f"training.{k}": v for k, v in spec.training.model_dump().items()}
    return {name: getattr(spec, name) for name in names} | training


def _settings(spec: RunSpec) -> dict[str, object]:
    """The settings of a run's method."""
    return {f"{spec.method.name}.{k}": v for k, v in spec.method.model_dump(mode="json").items()}


def _collection(spec: RunSpec) -> dict[str, object]:
    """The settings of the SimOpt that collects for a run, or that the run is."""
    simopt = spec.method if spec.method.name == "simopt" else spec.simopt
    if simopt is None:
        return {}
    return {f"simopt.{k}": v for k, v in simopt.model_dump(mode="json").items()}


def _changes_of(spec: RunSpec, facts: _Facts) -> dict[str, object]:
    """The facts of a run that differ from its preset's, which depend on the task.

    All facts, if the preset itself is invalid, as with more transitions than an episode has.
    """
    try:
        usual = facts(_usual(spec.task, spec.preset, spec.method.name, spec.collector))
    except ValidationError:
        usual = {}
    return {name: value for name, value in facts(spec).items() if usual.get(name) != value}


def _changed(spec: RunSpec, facts: _Facts) -> str:
    return canonical_json(_changes_of(spec, facts))


@cache
def _usual(task: str, preset: str, method: str, collector: str) -> RunSpec:
    """A run of the method with the preset's own budget and settings."""
    given = {"task": task, "preset": preset, "method": method, "collector": collector}
    return RunSpec.model_validate(given)


def _by_collection(outcomes: Sequence[Outcome]) -> list[list[Outcome]]:
    """Outcomes of one budget for each setting of the SimOpt that collects, with the methods that
    need no other's data; the preset's own first."""

    def collected(spec: RunSpec) -> str | None:
        return _changed(spec, _collection) if _collection(spec) else None

    known = {collected(outcome.spec) for outcome in outcomes} - {None}
    parts = sorted(known, key=lambda name: (name != _UNCHANGED, name)) or [None]
    return [[o for o in outcomes if collected(o.spec) in (None, part)] for part in parts]


def _by_settings(outcomes: Sequence[Outcome]) -> list[list[Outcome]]:
    """Outcomes of one budget with one setting of every method each.

    The first has the preset's own settings, or those of the first run of a method that never had
    them; every other setting has a part of its own, with the other methods as in the first.
    """
    groups: dict[str, dict[str, list[Outcome]]] = defaultdict(dict)
    for outcome in outcomes:
        settings = _changed(outcome.spec, _settings)
        groups[outcome.spec.column].setdefault(settings, []).append(outcome)
    chosen = {
        column: _UNCHANGED if _UNCHANGED in settings else next(iter(settings))
        for column, settings in groups.items()
    }
    first = [outcome for column, name in chosen.items() for outcome in groups[column][name]]
    others = [
        [*(o for o in first if o.spec.column != column), *group]
        for column, settings in groups.items()
        for name, group in settings.items()
        if name != chosen[column]
    ]
    return [first, *others]
