"""All mechanisms by kind, collected from the files that define them.

    mechanism = get_mechanism("joint_spring")

To add one, define a `Mechanism` in the file of its family, under its functions. A script adds one
of its own by `add`, for its own process alone: a service's processes do not know it.
"""

from adr_service.effects import actuators, bodies, contacts, joints, sensors, world
from adr_service.effects.base import Effect, Mechanism
from adr_service.errors import InvalidInput, UnknownName

_FAMILIES = (joints, actuators, bodies, world, contacts, sensors)  # scans keep this order
MECHANISMS: dict[str, Mechanism] = {}


def add(mechanism: Mechanism) -> None:
    """Add a mechanism to this process; raises InvalidInput if there is one of its kind already."""
    if mechanism.kind in MECHANISMS:
        raise InvalidInput(f"there is a mechanism {mechanism.kind!r} already; give another kind")
    MECHANISMS[mechanism.kind] = mechanism


def get_mechanism(kind: str) -> Mechanism:
    """The mechanism of a kind; raises UnknownName with the kinds there are."""
    if kind not in MECHANISMS:
        raise UnknownName("mechanism", kind, MECHANISMS)
    return MECHANISMS[kind]


def is_part(one: Effect, whole: Effect) -> bool:
    """True if one effect is what another is while its last strengths are zero."""
    return (one.kind, one.location) == (get_mechanism(whole.kind).includes, whole.location)


for _family in _FAMILIES:
    for _value in vars(_family).values():
        if isinstance(_value, Mechanism):
            add(_value)
