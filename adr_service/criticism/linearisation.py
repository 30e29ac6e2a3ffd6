"""Residuals of a simulator around given states, and their derivatives by all that is fitted.

    linear, predicted = linearise(simulator, layout, parameters, effects, states, root)

The columns of the result are the parameters, what integration adds, and the effects' strengths.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from adr_service.arrays import Array3, Mask, Matrix, Vector
from adr_service.criticism.layout import Layout
from adr_service.criticism.linear import Linear
from adr_service.criticism.noise import Chain
from adr_service.criticism.simulator import FINER, Simulator, other_integrator
from adr_service.effects.base import Effect
from adr_service.effects.catalogue import get_mechanism
from adr_service.effects.models import element_of, shapes_of, typical_of
from adr_service.errors import InvalidInput

# how much of what a finer step changes is really there, and of what another integrator changes at
# that step: prior means and deviations. Nothing, where the data were simulated alike; 3/2 of the
# first, where they are real and the integrator is of first order
_INTEGRATION = ((2 / 3, 2 / 3), (0.0, 1.0))
INTEGRATION = len(_INTEGRATION)  # columns
_DIFFERENCE = 1e-4  # of a parameter's range
_TINY = 1e-5  # of a state's spread over the recording, where its uncertainty is not known yet
_SIMULATED = 0.5  # of all transitions, at least
_Response = Callable[[tuple[Effect, ...]], Matrix]  # change (N, m) with other strengths
_TOUCHED = 1e-9  # what a contact or a limit changes at least, in units of that spread


@dataclass(frozen=True)
class _Point:
    """Parameters, effects and states (rows, m), with predictions (N, m) from there."""

    simulator: Simulator
    parameters: Vector
    effects: tuple[Effect, ...]
    states: Matrix
    predicted: Matrix
    quickly: Matrix

    def quickly_from(self, states: Matrix) -> Matrix:
        """Predictions (N, m) from other states."""
        return self.simulator.predict_quickly(self.parameters, self.effects, states)


def linearise(
    simulator: Simulator,
    layout: Layout,
    parameters: Vector,
    effects: tuple[Effect, ...],
    states: Matrix,
    root: np.ndarray,
) -> tuple[Linear, Matrix]:
    """Residuals around `states` (rows, m), their derivatives, and the predictions (N, m).

    Differences reach as far as the states are uncertain, along the columns of a root of their
    covariance (rows, m, m). So what is stiff is averaged over what the true state may be (the
    unscented transform; Julier and Uhlmann, 1997).
    """
    known = (parameters, effects, states)
    predicted = simulator.predict(*known)
    quickly = simulator.quickly(predicted, *known)
    point = _Point(simulator, *known, predicted, quickly)
    slopes, mean = _over_states(point, root)
    transition = slopes @ np.linalg.inv(root[simulator.starts])
    offset = (simulator.measured - states)[simulator.starts]
    after = simulator.measured[simulator.starts + 1]
    residual = after - mean - passed_on(transition, offset)
    columns = [
        *by_parameters(simulator, *known, quickly),
        *_by_integration(point),
        *by_strengths(simulator, *known, effects, quickly, transition),
    ]
    free = simulator.predict_free(*known)
    stiff = np.any(np.abs(free - quickly) > _TOUCHED * spread(simulator), axis=1)
    everything = np.concatenate([residual[..., None], transition, np.stack(columns, axis=2)], 2)
    return _folded(simulator, layout, everything, stiff, len(parameters)), predicted


def with_priors(chain: Chain, residual: Array3, columns: np.ndarray, parameters: int) -> Linear:
    """A linear model that knows nothing of parameters and strengths before the data, and something
    of integration."""
    mean, precision = np.zeros(columns.shape[3]), np.zeros(columns.shape[3])
    for where, (likely, deviation) in enumerate(_INTEGRATION, parameters):
        mean[where], precision[where] = likely, 1 / deviation**2
    return Linear(chain, residual, columns, mean, precision)


def by_strengths(
    simulator: Simulator,
    parameters: Vector,
    effects: tuple[Effect, ...],
    states: Matrix,
    by: Sequence[Effect],
    quickly: Matrix,
    transition: np.ndarray | None = None,
) -> list[Matrix]:
    """Derivatives (N, m) of the prediction `quickly` (N, m) by each strength of some effects.

    Without `transition`, readings stay, and behind an effect in a sensor the robot moves. With it
    (slopes (N, m, m) by the states) the robot stays and its readings move, so that it is not pushed
    into the ground. One prediction serves all effects in sensors.

    The smaller of the slopes to both sides, where a strength has two: a contact that begins or
    ends in between would make the one side infinitely steep. Of several strengths, those that are
    not identifiable are zero and stay so.
    """
    known = (parameters, effects, states)
    in_sensors = [effect for effect in by if get_mechanism(effect.kind).sensing is not None]
    shown: _Response | None = None
    if transition is not None and in_sensors:
        shown = _by_readings(simulator, *known, transition)

    def simulated(changed: tuple[Effect, ...]) -> Matrix:
        return simulator.predict_quickly(parameters, changed, states) - quickly

    derivatives: list[Matrix] = []
    for effect in by:
        response = shown if shown is not None and effect in in_sensors else simulated
        typical = typical_of(simulator.base, effect.kind, effect.location)
        for number, size in enumerate(typical):
            if len(typical) > 1 and effect.values[number] == 0:
                derivatives.append(np.zeros_like(quickly))
                continue
            slopes: list[Matrix] = []
            is_shape = shapes_of(effect.kind)[number]
            reach = 1 / _largest_angle(simulator, effect, states) if is_shape else size
            for step, moved in _moved_both_ways(effect, number, 0.01 * reach):
                changed = tuple(moved if each is effect else each for each in effects)
                slopes.append(response(changed) / step)
            derivatives.append(_flatter(*slopes))
    return derivatives


def _by_readings(
    simulator: Simulator,
    parameters: Vector,
    effects: tuple[Effect, ...],
    states: Matrix,
    transition: np.ndarray,
) -> _Response:
    """The change (N, m) by other strengths in sensors, which show the same motion."""
    true_states = simulator.true_states(parameters, effects, states)
    paths = simulator.paths(parameters, effects, true_states)
    before, after = simulator.sensors.shown(effects, paths)

    def response(changed: tuple[Effect, ...]) -> Matrix:
        now, then = simulator.sensors.shown(changed, paths)
        return then - after - passed_on(transition, (now - before)[simulator.starts])

    return response


def passed_on(transition: np.ndarray, change: np.ndarray) -> np.ndarray:
    """Change (…, m) of states one control step on, by slopes (…, m, m)."""
    return (transition @ change[..., None])[..., 0]


def _largest_angle(simulator: Simulator, effect: Effect, states: Matrix) -> float:
    """Largest angle [rad] of an effect's joint, by which its number of waves turns a phase."""
    dof = simulator.base.jnt_dofadr[element_of(simulator.base, effect.location)]
    return max(float(np.abs(states[:, dof]).max()), 1.0)


def _moved_both_ways(effect: Effect, number: int, size: float) -> Iterator[tuple[float, Effect]]:
    """Steps of one strength to both sides that make sense, and the effect after each."""
    low = get_mechanism(effect.kind).strengths[number].low
    for step in (size, -size):
        values = list(effect.values)
        values[number] += step
        if values[number] >= low:
            yield step, replace(effect, values=tuple(values))


def _flatter(one: Matrix, other: Matrix | None = None) -> Matrix:
    if other is None:
        return one
    return np.where(np.isnan(one) | (np.abs(other) < np.abs(one)), other, one)


def _over_states(point: _Point, root: np.ndarray) -> tuple[np.ndarray, Matrix]:
    """Slopes (N, m, m) of predictions along the columns of the root, and their mean (N, m) over
    what the states may be."""
    starts, m = point.simulator.starts, point.states.shape[1]
    slopes, mean = np.empty((len(starts), m, m)), point.predicted.copy()
    for column in range(m):
        step = root[:, :, column]
        above = point.quickly_from(point.states + step)
        below = point.quickly_from(point.states - step)
        slopes[:, :, column] = (above - below) / 2
        mean += (above + below) / 2 - point.quickly
    return slopes, mean


def by_parameters(
    simulator: Simulator,
    parameters: Vector,
    effects: tuple[Effect, ...],
    states: Matrix,
    quickly: Matrix,
) -> list[Matrix]:
    """Derivatives (N, m) of the prediction `quickly` (N, m) by each parameter."""
    space = simulator.nominal.space
    columns: list[Matrix] = []
    for number, size in enumerate(_DIFFERENCE * (space.high - space.low)):
        moved = parameters.copy()
        moved[number] += size
        columns.append((simulator.predict_quickly(moved, effects, states) - quickly) / size)
    return columns


def _by_integration(point: _Point) -> list[Matrix]:
    """Changes (N, m) by a finer step, and then by another integrator."""
    own = point.simulator.base.opt.integrator
    finer, other = (
        point.simulator.predict_finer(
            point.parameters, point.effects, point.states, FINER, integrator
        )
        for integrator in (own, other_integrator(own))
    )
    return [finer - point.predicted, other - finer]


def _folded(
    simulator: Simulator, layout: Layout, everything: np.ndarray, stiff: Mask, parameters: int
) -> Linear:
    """Residual, transition and columns (N, m, 1 + m + p) by episode, without the transitions
    whose simulation diverged; raises InvalidInput if too many did."""
    m = everything.shape[1]
    folded = layout.fold(everything)
    mask = layout.mask & np.all(np.isfinite(folded), axis=(2, 3))
    if mask.sum() < _SIMULATED * layout.mask.sum():
        raise InvalidInput(
            f"the simulation diverges from {int(layout.mask.sum() - mask.sum())} of "
            f"{int(layout.mask.sum())} measured states within a control step; the model's timestep "
            "may be too long, or its state is in other units than the measurement"
        )
    folded[~mask] = 0.0
    measured = simulator.data.is_measured()
    exact = (_TINY**2 * spread(simulator)) ** 2  # differences reach _TINY: an error of second order
    chain = Chain(mask, folded[..., 1 : m + 1], layout.fold(stiff), measured, exact)
    return with_priors(chain, folded[..., 0], folded[..., m + 1 :], parameters)


def tiny_root(simulator: Simulator) -> Matrix:
    """A root (m, m) of a state's covariance that is too small to matter."""
    return np.diag(_TINY * spread(simulator))


def root_of(covariance: np.ndarray, tiny: Matrix) -> np.ndarray:
    """Lower triangular roots of covariances (rows, m, m), kept invertible by tiny deviations."""
    scale = np.sqrt(np.maximum(np.diagonal(covariance, axis1=1, axis2=2), 0.0)) + np.diag(tiny)
    outer = scale[:, :, None] * scale[:, None, :]
    values, vectors = np.linalg.eigh((covariance + tiny**2) / outer)
    kept = np.maximum(values, 1e-9)
    sane = (vectors * kept[:, None, :]) @ vectors.swapaxes(1, 2) * outer
    return np.linalg.cholesky(sane)


def spread(simulator: Simulator) -> Vector:
    """(m,) standard deviation of each state over the recording."""
    return np.maximum(simulator.measured.std(axis=0), 1e-3)
