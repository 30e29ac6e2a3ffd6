"""First-order responses of a fit's predictions to effects that it does not have.

    response = Responses(baseline).of(effect)       # (E, T, m, strengths)

Each effect that has to be simulated is so once, for all scans, also those of later fits.
"""

from dataclasses import replace
from functools import cached_property

import numpy as np

from adr_service.arrays import Matrix
from adr_service.criticism.fits import Fit
from adr_service.effects.base import ByAngle, Effect
from adr_service.effects.catalogue import get_mechanism
from adr_service.effects.joints import COULOMB_FRICTION
from adr_service.effects.models import element_of, typical_of
from adr_service.effects.signals import offsets_of


def responses_to_forces(fit: Fit) -> list[Matrix]:
    """(N, m) response to a unit of force on each degree of freedom; zero where it diverges."""
    known = (fit.parameters, fit.effects, fit.states)
    return [np.nan_to_num(each) for each in fit.simulator.responses_to_forces(*known)]


class Responses:
    """Changes of a fit's predictions by effect.

    An effect in a sensor, on a command for a whole control step, or by a joint's angle is a
    combination of what is known of states, commands, forces and frictions already; any other effect
    is simulated once for each strength.
    """

    def __init__(self, fit: Fit):
        self._fit, self._simulator = fit, fit.simulator
        known = (fit.parameters, fit.effects, fit.states)
        self._predicted = self._simulator.quickly(fit.predicted, *known)
        self._rates = self._simulator.rates(*known)
        self._commands = self._simulator.commands(fit.effects, self._simulator.steps)
        self._unclamped: Matrix | None = None  # prediction (N, m) without limits of commands
        self._to_commands: dict[int, Matrix] = {}
        self._by_effect: dict[Effect, np.ndarray] = {}

    def of(self, effect: Effect) -> np.ndarray:
        """(E, T, m, strengths) change by each strength, one after the other."""
        mechanism = get_mechanism(effect.kind)
        if mechanism.by_angle is not None:  # it repeats otherwise in each scan
            response = self._by_angle(effect, mechanism.by_angle)
            response[~self._fit.linear.chain.mask] = 0.0
            return response
        if effect not in self._by_effect:
            if mechanism.sensing is not None:
                response = self._in_sensor(effect)
            elif mechanism.command is not None and not mechanism.is_late:
                response = self._on_command(effect)
            else:
                response = self._simulated(effect)
            response[~self._fit.linear.chain.mask] = 0.0  # nothing is known there
            self._by_effect[effect] = response
        return self._by_effect[effect]

    def _simulated(self, effect: Effect) -> np.ndarray:
        fit, steps, sizes = self._fit, [self._predicted], np.array(effect.values)
        for count in range(1, len(sizes) + 1):
            values = np.where(np.arange(len(sizes)) < count, sizes, 0.0)
            effects = (*fit.effects, replace(effect, values=tuple(values.tolist())))
            steps.append(self._simulator.predict_quickly(fit.parameters, effects, fit.states))
        return fit.layout.fold(np.diff(np.stack(steps, axis=2), axis=2))

    def _in_sensor(self, effect: Effect) -> np.ndarray:
        """The sensor shows something else before the step, and after it."""
        simulator, fit = self._simulator, self._fit
        known = (simulator.base, effect)
        before = offsets_of(*known, fit.states, self._rates, simulator.sensors.past)
        past = simulator.sensors.past_after(fit.states[simulator.starts], self._predicted)
        after = offsets_of(*known, self._predicted, self._rates[simulator.starts + 1], past)
        transition = fit.linear.chain.transition
        response = np.zeros(transition.shape[:3])
        for column, offset in before.items():
            folded = fit.layout.fold(np.column_stack([offset[simulator.starts], after[column]]))
            response -= transition[..., column] * folded[..., :1]
            response[..., column] += folded[..., 1]
        return response[..., None]

    def _on_command(self, effect: Effect) -> np.ndarray:
        """The actuator obeys something else, on average over a control step."""
        simulator, fit = self._simulator, self._fit
        actuator = element_of(simulator.base, effect.location)
        changed = simulator.commands((*fit.effects, effect), simulator.steps) - self._commands
        change = changed[:, :, actuator].mean(axis=1)
        return fit.layout.fold(self._to_command(actuator) * change[:, None])[..., None]

    def to_unit(self, kind: str, hinge: str) -> Matrix:
        """(N, m) response to a constant unit of what effects of a kind add by the angle of a hinge:
        a force, or a friction; zero where it diverges."""
        base, layout = self._simulator.base, self._fit.layout
        if get_mechanism(kind).friction is None:
            return self._to_forces[int(base.jnt_dofadr[element_of(base, hinge)])]
        typical = typical_of(base, COULOMB_FRICTION.kind, hinge)
        friction = self.of(Effect(COULOMB_FRICTION.kind, hinge, tuple(typical.tolist())))
        return np.nan_to_num(friction[layout.mask][..., 0] / typical)

    def _by_angle(self, effect: Effect, by_angle: ByAngle) -> np.ndarray:
        """The joint's angle is that at the start of each simulator step."""
        simulator, values = self._simulator, np.array(effect.values)
        dof = int(simulator.base.jnt_dofadr[element_of(simulator.base, effect.location)])
        before, after = self._fit.states[simulator.starts, dof], self._predicted[:, dof]
        added, steps = np.zeros((len(before), len(values))), simulator.quick_steps
        for step in range(steps):
            added += by_angle(before + step / steps * (after - before), values) / steps
        to_unit = self.to_unit(effect.kind, effect.location)
        return self._fit.layout.fold(to_unit[:, :, None] * added[:, None])

    @cached_property
    def _to_forces(self) -> list[Matrix]:
        return responses_to_forces(self._fit)

    def _to_command(self, actuator: int) -> Matrix:
        """(N, m) response to one unit of command, simulated once for all effects on it."""
        if actuator not in self._to_commands:
            fit, size = self._fit, 0.01 * self._simulator.largest_command(actuator)
            known = (fit.parameters, fit.effects, fit.states)
            if self._unclamped is None:
                self._unclamped = self._simulator.predict_unclamped(*known, actuator, 0.0)
            more = self._simulator.predict_unclamped(*known, actuator, size)
            self._to_commands[actuator] = (more - self._unclamped) / size
        return self._to_commands[actuator]
