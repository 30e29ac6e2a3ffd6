"""Effects that a measurement could show, before anything is fitted.

Each effect of the catalogue, at a size that a sensible simulator might lack, changes the prediction
of every control step. The change is compared with the error that the sensors' noise makes in a
difference of neighbouring rows. An effect that changes N predictions by s errors each gains about
N s²/2 nats, if no free parameter and no other effect can do the same, and if noise is all that is
left. So this is the best case: what it does not show, a criticism will hardly show. It counts what
hangs on few episodes, too, which is no evidence for a criticism.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from adr_service.arrays import Matrix, Vector
from adr_service.criticism.decision import THRESHOLD
from adr_service.criticism.scan import places
from adr_service.criticism.simulator import Simulator
from adr_service.effects.base import Effect
from adr_service.effects.catalogue import get_mechanism
from adr_service.effects.models import shapes_of, typical_of, unit_of

_LEAST = 1e-12  # of an error, where readings are exact


@dataclass(frozen=True)
class Excitation:
    """Evidence that one effect could gain at best from a measurement."""

    kind: str
    location: str
    nats: float  # that it would gain alone, at its typical size; NaN: it cannot be simulated
    strength: str  # name of the effect's first parameter
    sensible: float  # its typical value
    visible: float  # smallest value of it that could be evidence, others in proportion
    unit: str

    @property
    def is_shown(self) -> bool:
        """True if its typical size could be evidence."""
        return bool(self.nats >= THRESHOLD)


def excitation(simulator: Simulator, noise: Vector) -> list[Excitation]:
    """All effects at all places of a model, the best excited first.

    `noise` (2 nv,) has the deviations of positions and velocities, NaN where nothing is measured.
    """
    found: list[Excitation] = []
    for effect, nats in gained_by_effects(simulator, noise, simulator.measured):
        strength = get_mechanism(effect.kind).strengths[0]
        gain = float(np.nansum(nats)) if np.isfinite(nats).any() else np.nan
        visible = effect.values[0] * float(np.sqrt(THRESHOLD / max(gain, _LEAST)))
        unit = unit_of(simulator.base, effect.location, strength.unit)
        size = effect.values[0]
        found.append(
            Excitation(effect.kind, effect.location, gain, strength.name, size, visible, unit)
        )
    return sorted(found, key=lambda each: -np.nan_to_num(each.nats, nan=-1.0))


def gained_by_effects(
    simulator: Simulator, noise: Vector, states: Matrix
) -> Iterator[tuple[Effect, Vector]]:
    """Each effect at its typical size, and the nats (N,) that it would gain by each transition from
    `states` (rows, 2 nv), NaN where it diverges; none that has a shape, which only data tell."""
    start = simulator.nominal.start
    without = simulator.predict_quickly(start, (), states)
    for kind, location in places(simulator):
        if shapes_of(kind).any():
            continue
        typical = typical_of(simulator.base, kind, location)
        effect = Effect(kind, location, tuple(typical.tolist()))
        changed = simulator.predict_quickly(start, (effect,), states)
        share = _in_errors(changed - without, noise, simulator.period)
        yield effect, np.sum(share**2, axis=1) / 2


def _in_errors(change: Matrix, noise: Vector, period: float) -> Matrix:
    """Changes (N, 2 nv) of predictions in units of their errors by noise.

    Of a joint whose velocity is not measured, three neighbouring positions show a force: their
    second difference changes as the position does, and by half a step's motion at the changed
    velocity.
    """
    nv = change.shape[1] // 2
    position, velocity = noise[:nv], noise[nv:]
    is_blind = np.isnan(velocity)
    moved = change[:, :nv] + np.where(is_blind, period / 2 * change[:, nv:], 0.0)
    of_position = np.where(
        is_blind, np.sqrt(6) * position, np.hypot(np.sqrt(2) * position, period * velocity)
    )
    share = np.hstack([moved, change[:, nv:]])
    unit = np.concatenate([of_position, np.sqrt(2) * velocity])
    is_known = ~np.isnan(unit)
    return share[:, is_known] / np.maximum(unit[is_known], _LEAST)
