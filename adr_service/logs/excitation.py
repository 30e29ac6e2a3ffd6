"""What a measurement could show at all, before anything is fitted.

Each effect of the catalogue, at a size that a sensible simulator might lack, changes the prediction
of every control step. The change is compared with the error that the sensors' noise makes in a
difference of neighbouring rows. An effect that changes N predictions by s errors each gains about
N s²/2 nats, if no free parameter and no other effect can do the same, and if noise is all that is
left. So this is the best case: what it does not show, a criticism will hardly show.
"""

from dataclasses import dataclass

import numpy as np

from adr_service.arrays import Matrix, Vector
from adr_service.criticism.decision import THRESHOLD
from adr_service.criticism.simulator import Simulator
from adr_service.effects.base import Effect, sensors
from adr_service.effects.catalogue import MECHANISMS
from adr_service.effects.models import typical_of, unit_of

_LEAST = 1e-12  # of an error, where readings are exact


@dataclass(frozen=True)
class Excitation:
    """How well a measurement could show one effect."""

    kind: str
    location: str
    nats: (
        float  # that the effect would gain at its typical size, alone; NaN: it cannot be simulated
    )
    strength: str  # name of the effect's first parameter
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
    start, states = simulator.nominal.start, simulator.measured
    without = simulator.predict_quickly(start, (), states)
    readings = zip(sensors(simulator.base), simulator.data.is_measured(), strict=True)
    unread = [f"sensor:{name}" for name, is_measured in readings if not is_measured]
    found: list[Excitation] = []
    for kind, mechanism in MECHANISMS.items():
        if mechanism.only_spreads:
            continue
        for location in mechanism.locations(simulator.base):
            typical = typical_of(simulator.base, kind, location)
            effect = Effect(kind, location, tuple(typical.tolist()))
            if not typical.any() or location in unread:
                continue
            changed = simulator.predict_quickly(start, (effect,), states)
            share = _in_errors(changed - without, noise, simulator.period)
            nats = float(np.nansum(share**2)) / 2 if np.isfinite(share).any() else np.nan
            strength = mechanism.strengths[0]
            visible = typical[0] * np.sqrt(THRESHOLD / max(nats, _LEAST))
            unit = unit_of(simulator.base, location, strength.unit)
            found.append(Excitation(kind, location, nats, strength.name, float(visible), unit))
    return sorted(found, key=lambda each: -np.nan_to_num(each.nats, nan=-1.0))


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
    sped = change[:, nv:][:, ~is_blind] / np.maximum(np.sqrt(2) * velocity[~is_blind], _LEAST)
    return np.hstack([moved / np.maximum(of_position, _LEAST), sped])
