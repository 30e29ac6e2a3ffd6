"""Filling a run's spec from its preset: given fields win, one by one."""

from typing import Any, cast

from adr_service.methods.catalogue import methods, names_of
from adr_service.presets import PRESETS
from adr_service.specs.names import as_given
from adr_service.specs.target import EXTERNAL_EPISODES
from adr_service.training.settings import DEFAULT_ALGORITHM

_DEFAULT = "quick"
# of a preset's training, what holds for every algorithm
_BUDGET = ("backend", "max_steps", "evaluate_every", "stop_at_threshold")


def filled_from_preset(given: dict[str, Any]) -> dict[str, Any]:
    """A run's fields with those of its preset in the place of what was not given.

    Fields that are wrong stay as they are, for their own validation to refuse.
    """
    given = {name: as_given(value) for name, value in given.items()}
    name = given.get("preset", _DEFAULT)
    # a wrong preset is refused by its field, and no other field shall look wrong beside it
    preset = PRESETS[name if isinstance(name, str) and name in PRESETS else _DEFAULT]
    filled = {"preset": _DEFAULT, **preset["run"], **given}
    if isinstance(training := given.get("training", {}), dict):
        filled["training"] = {**_usual_training(preset, given.get("task"), training), **training}
    if "method" in given:
        filled["method"] = _filled_method(given["method"], preset["methods"])
    kind = _kind_of(filled.get("target"))
    if kind == "external" and "evaluation_episodes" not in given:
        filled["evaluation_episodes"] = EXTERNAL_EPISODES
    if kind == "recorded":
        filled.setdefault("collector", "recording")
    return filled | _filled_simopt(filled, given.get("simopt"), preset["methods"])


def learns_from_simopt(spec: dict[str, Any]) -> bool:
    """True if a spec, perhaps an invalid one, is of an offline method that sees SimOpt's data."""
    method = spec.get("method")
    name = cast(dict[str, Any], method).get("name") if isinstance(method, dict) else method
    return name in names_of("recordings") and spec.get("collector", "simopt") == "simopt"


def _usual_training(preset: dict[str, Any], task: Any, given: dict[str, Any]) -> dict[str, Any]:
    """A preset's training of a task; for another algorithm, its budget alone."""
    own = preset.get("trainings", {})
    usual = own[task] if isinstance(task, str) and task in own else preset["run"]["training"]
    own_algorithm = usual.get("algorithm", DEFAULT_ALGORITHM)
    if given.get("algorithm", own_algorithm) == own_algorithm:
        return usual
    return {name: value for name, value in usual.items() if name in _BUDGET}


def _filled_method(given: Any, defaults: dict[str, dict[str, Any]]) -> Any:
    """A method's settings from its name or its partial settings, and the preset's."""
    if isinstance(given, str) and given in methods():
        given = {"name": given}
    if isinstance(given, dict) and isinstance(name := given.get("name"), str):
        return {**defaults.get(name, {}), **given}
    return given


def _filled_simopt(
    filled: dict[str, Any], given: Any, defaults: dict[str, dict[str, Any]]
) -> dict[str, Any]:
    """The settings of the SimOpt that collects, where the run learns from its trajectories."""
    if given is None and learns_from_simopt(filled):
        given = {}
    if isinstance(given, str):
        given = {"name": given}
    if not isinstance(given, dict):
        return {}
    return {"simopt": {**defaults.get("simopt", {}), **given}}


def _kind_of(target: Any) -> Any:
    return cast(dict[str, Any], target).get("kind") if isinstance(target, dict) else None
