"""The physical effects that a simulator may lack, put into models.

    cause = Cause("joint_coulomb_friction", "joint:leg_joint", (2.0,))
    model = with_causes(spec, lambda model: None, [cause])        # a compiled MjModel

A mechanism acts in one of three ways. Most change fields of the compiled model; those that need
an element of their own get it at zero strength first (`prepare`). Some transform the commands on
their way to the actuators, and some what sensors show. Zero strength is no effect, to the bit.
A target hides mechanisms, criticism finds them, and both use what stands in `effects.py`.
"""

from collections.abc import Callable, Sequence

import mujoco
import numpy as np

from adr_service.causes import Cause
from adr_service.errors import InvalidInput, UnknownName
from adr_service.simulation.effects import CATALOGUE
from adr_service.simulation.mechanism import Mechanism, sensors

MECHANISMS: dict[str, Mechanism] = {mechanism.kind: mechanism for mechanism in CATALOGUE}
_OF_SLIDES = {
    "N m": "N",
    "N m/rad": "N/m",
    "N m s/rad": "N s/m",
    "kg m²": "kg",
    "rad": "m",
    "rad/s": "m/s",
}
_Inferred = mujoco.mjtInertiaFromGeom


def unit_of(model: mujoco.MjModel, location: str, unit: str) -> str:
    """A strength's unit at a place: catalogue units are those of hinges."""
    place, _, name = location.partition(":")
    joint = name.rpartition(".")[0] if place == "sensor" else name
    if place == "actuator":
        joint = model.joint(int(model.actuator_trnid[model.actuator(name).id, 0])).name
    is_slide = place in ("joint", "actuator", "sensor") and (
        model.joint(joint).type[0] == mujoco.mjtJoint.mjJNT_SLIDE
    )
    if unit == "of the sensor":
        unit = "rad/s" if name.endswith(".velocity") else "rad"
    return _OF_SLIDES.get(unit, unit) if is_slide else unit


def with_causes(
    spec: mujoco.MjSpec, write: Callable[[mujoco.MjModel], None], causes: Sequence[Cause]
) -> mujoco.MjModel:
    """A compiled model with causes on top of what `write` puts into it.

    The spec gets the elements that the causes need, and may be told the model by `copy_back`.
    """
    model = prepared(spec, causes)
    write(model)
    apply(model, causes)
    mujoco.mj_setConst(model, mujoco.MjData(model))
    return model


def prepared(spec: mujoco.MjSpec, causes: Sequence[Cause]) -> mujoco.MjModel:
    """The compiled model with the elements that the causes need, at zero strength."""
    for cause in causes:
        mechanism = get_mechanism(cause.kind)
        if mechanism.prepare is not None:
            mechanism.prepare(spec, cause.name)
    try:
        return spec.compile()
    except ValueError as error:
        raise InvalidInput(f"MuJoCo cannot compile the model: {error}") from error


def apply(model: mujoco.MjModel, causes: Sequence[Cause]) -> None:
    """Change a prepared model by causes; derived constants are the caller's."""
    for cause in causes:
        mechanism = get_mechanism(cause.kind)
        if mechanism.change is not None:
            mechanism.change(model, element_of(model, cause.location), np.array(cause.values))


def openly(spec: mujoco.MjSpec) -> None:
    """Let a model's bodies take causes: their inertias written out, and none of them shortened."""
    inferred = spec.compiler.inertiafromgeom == _Inferred.mjINERTIAFROMGEOM_TRUE
    spec.compiler.inertiafromgeom = _Inferred.mjINERTIAFROMGEOM_AUTO
    for body in spec.bodies[1:]:
        body.simple = False  # such bodies keep their centre of mass where it is
        if inferred or not body.explicitinertial:
            body.explicitinertial = False
            spec.adopt_inertial(body)  # so that a cause may change it
    spec.compiler.inertiafromgeom = _Inferred.mjINERTIAFROMGEOM_FALSE


def check_simulated(model: mujoco.MjModel, causes: Sequence[Cause]) -> None:
    """Raises InvalidInput unless each is an effect in the model itself, at a place it has."""
    for number, cause in enumerate(causes):
        if (cause.kind, cause.location) in [(c.kind, c.location) for c in causes[:number]]:
            raise InvalidInput(f"{cause.kind} at {cause.location} is given twice; give it once")
        mechanism = get_mechanism(cause.kind)
        if mechanism.change is None:
            possible = [kind for kind, each in MECHANISMS.items() if each.change is not None]
            raise InvalidInput(
                f"{cause.kind} acts on commands or in sensors, which simulations that train "
                f"policies do not replay; accepted: {', '.join(possible)}"
            )
        if cause.location not in mechanism.locations(model):
            raise UnknownName(f"place of {cause.kind}", cause.location, mechanism.locations(model))
        lows = [strength.low for strength in mechanism.strengths]
        if len(cause.values) != len(lows) or any(
            not np.isfinite(v) or v < low for v, low in zip(cause.values, lows, strict=True)
        ):
            names = [f"{s.name} [{s.unit}], {s.low:g} at least" for s in mechanism.strengths]
            raise InvalidInput(f"{cause.kind} takes {', '.join(names)}; given {list(cause.values)}")


def element_of(model: mujoco.MjModel, location: str) -> int:
    """The number of the element that a location names; 0 for what is global."""
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


def get_mechanism(kind: str) -> Mechanism:
    """Raises UnknownName with the kinds there are."""
    if kind not in MECHANISMS:
        raise UnknownName("mechanism", kind, list(MECHANISMS))
    return MECHANISMS[kind]
