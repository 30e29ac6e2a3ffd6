"""What a simulator may lack, as a value: one effect at one place.

    cause = Cause("joint_coulomb_friction", "joint:leg_joint", (2.0,))

`simulation.mechanisms` knows what the kinds do. A *domain* is the name of a task's variant with
effects beyond its own: `vanilla@[{"kind": …}]`.
"""

import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass

from adr_service.json_values import canonical_json

_SEPARATOR = "@"


@dataclass(frozen=True)
class Cause:
    """One effect at one place, with its strengths in the mechanism's order."""

    kind: str
    location: str  # "joint:leg_joint", or "global"
    values: tuple[float, ...]

    @property
    def name(self) -> str:
        """What is at the location, without its kind."""
        return self.location.partition(":")[2]


def domain_of(variant: str, causes: Sequence[Cause]) -> str:
    """The variant with these effects; just the variant where there are none."""
    effects = canonical_json([asdict(cause) for cause in causes])
    return variant + _SEPARATOR + effects if causes else variant


def parse_domain(domain: str) -> tuple[str, tuple[Cause, ...]]:
    """The variant and its effects."""
    variant, _, effects = domain.partition(_SEPARATOR)
    found = json.loads(effects) if effects else []
    return variant, tuple(Cause(c["kind"], c["location"], tuple(c["values"])) for c in found)
