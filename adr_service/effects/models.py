"""Effects put into compiled models.

    effect = Effect("joint_coulomb_friction", "joint:leg_joint", (2.0,))
    model = with_effects(spec, lambda model: None, [effect])        # a compiled MjModel

Most mechanisms change fields of the compiled model. One that needs an element of its own gets it
at zero strength first (`prepare`). Zero strength is no effect, to the last bit. `signals.py` has
the effects on commands and in sensors.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace
from itertools import count

import mujoco
import numpy as np

from adr_service.arrays import Mask, Vector
from adr_service.effects.base import Effect, sensors
from adr_service.effects.catalogue import MECHANISMS, get_mechanism
from adr_service.errors import InvalidInput, UnknownName

_OF_SLIDES = {
    "N m": "N",
    "N m/rad": "N/m",
    "N m/rad³": "N/m³",
    "N m s/rad": "N s/m",
    "N m s²/rad²": "N s²/m²",
    "kg m²": "kg",
    "rad": "m",
    "rad/s": "m/s",
}
_Inferred = mujoco.mjtInertiaFromGeom
_WIDER = 25.0  # than typical: the usual deviation of what real robots have and models lack
_ON_JOINTS = (mujoco.mjtTrn.mjTRN_JOINT, mujoco.mjtTrn.mjTRN_JOINTINPARENT)


def with_effects(
    spec: mujoco.MjSpec, write: Callable[[mujoco.MjModel], None], effects: Sequence[Effect]
) -> mujoco.MjModel:
    """A compiled model with effects on top of what `write` puts into it.

    The spec gets the elements that the effects need; `spec.copy_back(model)` then has all of it but
    the compensation of gravity.
    """
    model = prepared(spec, effects)
    write_all(model, write, effects)
    return model


def write_all(
    model: mujoco.MjModel, write: Callable[[mujoco.MjModel], None], effects: Sequence[Effect]
) -> None:
    """Put what `write` does, and effects on top of it, into a prepared model."""
    write(model)
    apply(model, effects)
    mujoco.mj_setConst(model, mujoco.MjData(model))


def elements_of(effects: Sequence[Effect]) -> tuple[Effect, ...]:
    """The effects that need elements of their own, without strengths: models share them."""
    prepare = [effect for effect in effects if get_mechanism(effect.kind).prepare is not None]
    return tuple(replace(effect, values=()) for effect in prepare)


def prepared(spec: mujoco.MjSpec, effects: Sequence[Effect]) -> mujoco.MjModel:
    """The compiled model with the elements that the effects need, at zero strength."""
    for effect in effects:
        mechanism = get_mechanism(effect.kind)
        if mechanism.prepare is not None:
            mechanism.prepare(spec, effect.name)
    try:
        return spec.compile()
    except ValueError as error:
        raise InvalidInput(f"MuJoCo cannot compile the model: {error}") from error


def apply(model: mujoco.MjModel, effects: Sequence[Effect]) -> None:
    """Change a prepared model by effects; the caller recomputes derived constants."""
    for effect in effects:
        mechanism = get_mechanism(effect.kind)
        if mechanism.change is not None:
            mechanism.change(model, element_of(model, effect.location), np.array(effect.values))


def name_all(spec: mujoco.MjSpec) -> None:
    """Give elements that have no name a free one, because an effect needs a place."""
    for elements in (spec.bodies, spec.joints, spec.geoms, spec.actuators):
        taken = {element.name for element in elements}
        for number, element in enumerate(elements):
            if not element.name:
                element.name = next(n for k in count(number) if (n := f"unnamed_{k}") not in taken)
                taken.add(element.name)


def make_inertias_explicit(spec: mujoco.MjSpec) -> None:
    """Write out every body's inertia, so that effects can change it, also beyond bounds."""
    inferred = spec.compiler.inertiafromgeom == _Inferred.mjINERTIAFROMGEOM_TRUE
    spec.compiler.inertiafromgeom = _Inferred.mjINERTIAFROMGEOM_AUTO
    for body in spec.bodies[1:]:
        body.simple = False  # such bodies keep their centre of mass where it is
        if inferred or not body.explicitinertial:
            body.explicitinertial = False
            spec.adopt_inertial(body)
    spec.compiler.inertiafromgeom = _Inferred.mjINERTIAFROMGEOM_FALSE
    if spec.compiler.boundmass > 0 or spec.compiler.boundinertia > 0:
        whole = spec.copy()
        whole.compiler.fusestatic = False  # so that bodies keep their numbers
        bounded = whole.compile()
        for number, body in enumerate(spec.bodies[1:], 1):
            body.mass, body.inertia = float(bounded.body_mass[number]), bounded.body_inertia[number]
            body.ipos, body.iquat = bounded.body_ipos[number], bounded.body_iquat[number]
            body.fullinertia = np.full(6, np.nan)
        spec.compiler.boundmass = spec.compiler.boundinertia = 0.0


def check_simulated(model: mujoco.MjModel, effects: Sequence[Effect]) -> None:
    """Raises InvalidInput unless each effect is in the robot itself, at a place that it has."""
    for number, effect in enumerate(effects):
        if (effect.kind, effect.location) in [(e.kind, e.location) for e in effects[:number]]:
            raise InvalidInput(f"{effect.kind} at {effect.location} is given twice; give it once")
        mechanism = get_mechanism(effect.kind)
        if mechanism.command or mechanism.sensing:
            possible = [
                kind for kind, each in MECHANISMS.items() if not (each.command or each.sensing)
            ]
            raise InvalidInput(
                f"{effect.kind} acts on commands or in sensors, which simulations that train "
                f"policies do not replay; accepted: {', '.join(possible)}"
            )
        if effect.location not in mechanism.locations(model):
            raise UnknownName(
                f"place of {effect.kind}", effect.location, mechanism.locations(model)
            )
        _check_values(effect)


def _check_values(effect: Effect) -> None:
    strengths = get_mechanism(effect.kind).strengths
    if len(effect.values) != len(strengths) or any(
        not np.isfinite(v) or v < s.low for v, s in zip(effect.values, strengths, strict=True)
    ):
        names = [f"{s.name} [{s.unit}], {s.low:g} at least" for s in strengths]
        raise InvalidInput(f"{effect.kind} takes {', '.join(names)}; given {list(effect.values)}")


def element_of(model: mujoco.MjModel, location: str) -> int:
    """Number of the element at a location; 0 for the global one, a column for a sensor."""
    place, _, name = location.partition(":")
    if place == "global":
        return 0
    if place == "sensor":
        names = sensors(model)
        if name not in names:
            raise UnknownName("sensor", name, names)
        return names.index(name)
    try:
        return int(getattr(model, place)(name).id)
    except (KeyError, AttributeError) as error:
        raise InvalidInput(f"the model has no {location!r}: {error}") from error


def typical_of(model: mujoco.MjModel, kind: str, location: str) -> Vector:
    """Sizes (k,) of a mechanism's strengths that a sensible simulator might lack at a place."""
    return np.array(get_mechanism(kind).typical(model, element_of(model, location)), dtype=float)


def plausible_of(model: mujoco.MjModel, effect: Effect) -> Vector:
    """Deviations (k,) of an effect's strengths among all robots, about zero."""
    if (likely := get_mechanism(effect.kind).likely) is not None:
        return np.array(likely(model, element_of(model, effect.location)), dtype=float)
    return _WIDER * typical_of(model, effect.kind, effect.location)


def prior_precision(model: mujoco.MjModel, effects: Sequence[Effect]) -> Vector:
    """Precisions (k,) of the priors of all strengths, each as a multiple of the effect's own."""
    sizes = [np.array(effect.values) / plausible_of(model, effect) for effect in effects]
    return np.concatenate([*sizes, np.empty(0)]) ** 2


def amounts(effect: Effect) -> Vector:
    """(k,) strengths of an effect, with zeros for those that are shapes: its whole response is the
    sum of the derivatives by its strengths, times these."""
    return np.where(shapes_of(effect.kind), 0.0, effect.values)


def shapes_of(kind: str) -> Mask:
    """(k,) true for strengths of a mechanism that say how the others act, and not how much."""
    return np.array([strength.is_shape for strength in get_mechanism(kind).strengths])


def sensible(effect: Effect, values: Vector) -> Effect:
    """The effect at these strengths, each at the edge of what makes sense at most."""
    low = [strength.low for strength in get_mechanism(effect.kind).strengths]
    return replace(effect, values=tuple(np.maximum(values, low).tolist()))


def unit_of(model: mujoco.MjModel, location: str, unit: str) -> str:
    """Unit of a strength at a place; the catalogue has the units of hinges.

    An actuator on a tendon or a site moves no joint of its own and has the catalogue's unit.
    """
    if unit == "of the sensor":
        unit = "rad/s" if location.endswith(".velocity") else "rad"
    joint = _joint_at(model, location)
    is_slide = joint is not None and model.jnt_type[joint] == mujoco.mjtJoint.mjJNT_SLIDE
    return _OF_SLIDES.get(unit, unit) if is_slide else unit


def _joint_at(model: mujoco.MjModel, location: str) -> int | None:
    """Number of the joint at a location, or that a sensor reads or an actuator moves."""
    place, _, name = location.partition(":")
    match place:
        case "joint":
            return model.joint(name).id
        case "sensor":
            return model.joint(name.rpartition(".")[0]).id
        case "actuator":
            actuator = model.actuator(name).id
            is_on_joint = int(model.actuator_trntype[actuator]) in _ON_JOINTS
            return int(model.actuator_trnid[actuator, 0]) if is_on_joint else None
        case _:
            return None
