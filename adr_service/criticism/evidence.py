"""How much better the data are predicted with a cause than without it.

    baseline = smoothed(fit(simulator, sensor), sensor)  # free parameters, noise, smoothed states
    found = scan(baseline, Effects(baseline))            # every (kind, location), linearised
    refined = refine(baseline, found[0].causes, sensor)  # nonlinear, with its own noise

All fits are Gauss-Newton steps on whitened one-step residuals around smoothed states. A gain is
the log-likelihood, in nats, of episodes that were left out one at a time from the fit, with the
cause minus without. What the free parameters can explain is not evidence: they are fitted in both;
nor is what a smaller simulator step would change, which is fitted as if it were a parameter.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from adr_service.arrays import Array3, Indices, Mask, Matrix, Vector
from adr_service.causes import Cause
from adr_service.criticism.linear import Linear, Normal, estimate
from adr_service.criticism.noise import Chain, Noise, Whitener, at_start, lifted, misfit_variance
from adr_service.criticism.simulator import Simulator, other_integrator
from adr_service.errors import InvalidInput
from adr_service.simulation.mechanisms import element_of, get_mechanism

FINER = 3  # how much smaller a step shows what numerical integration adds
# how much of what a finer step changes is really there, and of what another integrator changes at
# that step: prior means and deviations. Nothing, where the data were simulated alike; 4/3 of the
# first, where they are real and the integrator is of first order
_INTEGRATION = ((2 / 3, 2 / 3), (0.0, 1.0))
INTEGRATION = len(_INTEGRATION)  # columns
_ROUNDS, _CONVERGED = 4, 0.3  # of steps at most; [nats] that a step gains at least
_DIFFERENCE = 1e-4  # of a parameter's range
_TINY = 1e-5  # of a state's spread over the recording, where its uncertainty is not known yet
_SIMULATED = 0.5  # of all transitions, at least
_TOUCHED = 1e-9  # what a contact or a limit changes at least, in units of that spread


@dataclass(frozen=True)
class Layout:
    """Transitions (N,) by episode (E, T), padded."""

    index: Indices  # (E, T)
    mask: Mask  # (E, T)

    @classmethod
    def of(cls, simulator: Simulator) -> "Layout":
        episodes = simulator.data.episode[simulator.starts]
        lengths = np.unique(episodes, return_counts=True)[1]
        mask = np.arange(lengths.max()) < lengths[:, None]
        index = np.zeros(mask.shape, dtype=np.int64)
        index[mask] = np.arange(len(episodes))
        return cls(index, mask)

    def fold(self, values: np.ndarray) -> np.ndarray:
        """(N, ...) as (E, T, ...), zero where there is no transition."""
        folded = values[self.index]
        folded[~self.mask] = 0
        return folded

    def by_row(self, simulator: Simulator, values: np.ndarray) -> np.ndarray:
        """(E, T + 1, ...) of states, as rows of the measurement (rows, ...)."""
        spans = simulator.data.spans()
        rows = [v[: last - first] for v, (first, last) in zip(values, spans, strict=True)]
        return np.concatenate(rows)


@dataclass(frozen=True)
class Fit:
    """A simulator with fitted parameters and causes, and what it leaves unexplained.

    The columns of `linear` and `normal` are the parameters, integration, the causes' strengths.
    """

    simulator: Simulator
    layout: Layout
    parameters: Vector  # (d,) SI
    causes: tuple[Cause, ...]
    states: Matrix  # (rows, m) smoothed, around which everything is linear
    linear: Linear
    noise: Noise
    normal: Normal

    @property
    def held_out(self) -> Vector:
        """(E,) nats: log-likelihood of each episode by a fit to the others."""
        return self.normal.left_out()

    @property
    def left(self) -> Array3:
        """(E, T, m) residuals that the fitted columns leave."""
        return self.linear.residual - self.linear.columns @ self.normal.change()[0]


def fit(simulator: Simulator, sensor: Vector, causes: Sequence[Cause] = ()) -> Fit:
    """The simulator at its best with these causes, around the states as they were measured.

    `sensor` (m,) are the variances of the sensors' noise, NaN where they are not known.
    """
    layout, states = Layout.of(simulator), simulator.measured
    root = np.broadcast_to(_tiny(simulator), (*states.shape, states.shape[1]))
    start = simulator.nominal.start
    linear = _linearise(simulator, layout, start, tuple(causes), states, root)
    noise = _first_noise(linear, sensor)
    return _fitted(simulator, layout, start, tuple(causes), states, linear, noise, sensor)


def smoothed(fit: Fit, sensor: Vector) -> Fit:
    """A fit anew, around the states that are the most probable under it."""
    simulator, layout, linear = fit.simulator, fit.layout, fit.linear
    whitener = Whitener.of(linear.chain, fit.noise)
    errors, covariance = whitener.sensor_errors(fit.left)
    states = simulator.measured - layout.by_row(simulator, errors)
    root = _root(layout.by_row(simulator, covariance), _tiny(simulator))
    anew = _linearise(simulator, layout, fit.parameters, fit.causes, states, root)
    return _fitted(simulator, layout, fit.parameters, fit.causes, states, anew, fit.noise, sensor)


def residuals_of(fit: Fit, simulator: Simulator) -> tuple[Chain, Array3]:
    """What a fit leaves of other data (E, T, m), around the states as they were measured."""
    layout, states = Layout.of(simulator), simulator.measured
    root = np.broadcast_to(_tiny(simulator), (*states.shape, states.shape[1]))
    linear = _linearise(simulator, layout, fit.parameters, fit.causes, states, root)
    integration = slice(len(fit.parameters), len(fit.parameters) + INTEGRATION)
    change = fit.normal.change()[0][integration]
    return linear.chain, linear.residual - linear.columns[..., integration] @ change


def expected_errors(fit: Fit) -> Vector:
    """Typical deviation (m,) of a one-step error by a fit; NaN of what was not measured."""
    chain, noise = fit.linear.chain, fit.noise
    variance = (chain.transition[chain.mask] ** 2) @ noise.sensor + noise.sensor
    variance = np.median(variance + misfit_variance(chain, noise)[chain.mask], axis=0)
    return np.where(fit.simulator.data.is_measured(), np.sqrt(variance), np.nan)


def _fitted(
    simulator: Simulator,
    layout: Layout,
    parameters: Vector,
    causes: tuple[Cause, ...],
    states: Matrix,
    linear: Linear,
    noise: Noise,
    sensor: Vector,
) -> Fit:
    """The best parameters and strengths, from a first guess of the noise."""
    known = ~np.isnan(sensor)
    noise, normal = estimate(linear, lifted(noise, linear.chain, linear.residual, known), known)
    found = Fit(simulator, layout, parameters, causes, states, linear, noise, normal)
    return refine(found, causes, sensor) or found


def refine(fit: Fit, causes: Sequence[Cause], sensor: Vector) -> Fit | None:
    """The fit with these causes, from strengths near the best ones; its states stay.

    A step that makes the data less probable is halved. None: with these causes the simulation
    diverges where it did not before, and they explain nothing. Compare with `settled(fit)`.
    """
    before = fit.simulator.predict(fit.parameters, fit.causes, fit.states)
    integration = slice(len(fit.parameters), len(fit.parameters) + INTEGRATION)
    known = ~np.isnan(sensor)
    noise = lifted(fit.noise, fit.linear.chain, fit.left, known)
    best = _evaluated(fit, before, fit.parameters, tuple(causes), noise, sensor)
    if best is None:
        return None
    step = best.normal.change()[0]
    reached = best.normal.settled(integration)
    for _ in range(_ROUNDS - 1):
        parameters = _moved(fit.simulator, best.parameters, step)
        moved = _strengthened(best.causes, step[integration.stop :])
        tried = _evaluated(fit, before, parameters, moved, best.noise, sensor)
        gained = -np.inf if tried is None else tried.normal.settled(integration) - reached
        if tried is None or gained <= 0:
            step = step / 2
            continue
        best, step, reached = tried, tried.normal.change()[0], reached + gained
        if gained < _CONVERGED:
            break
    return best


def settled(fit: Fit, sensor: Vector) -> Fit:
    """The fit with its own causes, its strengths and noise settled around its states."""
    return refine(fit, fit.causes, sensor) or fit


def _evaluated(
    fit: Fit,
    before: Matrix,
    parameters: Vector,
    causes: tuple[Cause, ...],
    noise: Noise,
    sensor: Vector,
) -> Fit | None:
    """Another fit's states and sensitivities, with other parameters and causes.

    `before` is what the other fit predicts. None: some transition diverges, or the noise does.
    """
    simulator, layout = fit.simulator, fit.layout
    predicted = simulator.predict(parameters, causes, fit.states)
    effects = _derivatives(simulator, parameters, causes, fit.states)
    moved = layout.fold(np.stack([predicted - before, *effects], axis=2))
    moved[~fit.linear.chain.mask] = 0.0
    if not np.all(np.isfinite(moved)):
        return None
    known = fit.linear.columns[..., : len(parameters) + INTEGRATION]
    linear = _known_before(
        fit.linear.chain,
        fit.linear.residual - moved[..., 0],
        np.concatenate([known, moved[..., 1:]], axis=3),
        len(parameters),
    )
    try:
        noise, normal = estimate(linear, noise, ~np.isnan(sensor))
    except np.linalg.LinAlgError:  # what it leaves has no finite variance beside exact readings
        return None
    return Fit(simulator, layout, parameters, causes, fit.states, linear, noise, normal)


def _linearise(
    simulator: Simulator,
    layout: Layout,
    parameters: Vector,
    causes: tuple[Cause, ...],
    states: Matrix,
    root: np.ndarray,
) -> Linear:
    """Residuals around `states`, and how they would change.

    Differences reach as far as the states are uncertain, along the columns of a root of their
    covariance (rows, m, m), so that what is stiff is averaged over what the true state may be (the
    unscented transform; Julier and Uhlmann, 1997).
    """
    starts, m = simulator.starts, states.shape[1]
    predicted = simulator.predict(parameters, causes, states)
    quickly = simulator.predict_quickly(parameters, causes, states)
    slopes, mean = np.empty((len(starts), m, m)), predicted.copy()
    for column in range(m):
        step = root[:, :, column]
        above = simulator.predict_quickly(parameters, causes, states + step)
        below = simulator.predict_quickly(parameters, causes, states - step)
        slopes[:, :, column] = (above - below) / 2
        mean += (above + below) / 2 - quickly
    transition = slopes @ np.linalg.inv(root[starts])
    offset = (simulator.measured - states)[starts]
    residual = simulator.measured[starts + 1] - mean - (transition @ offset[..., None])[..., 0]
    columns: list[Matrix] = []
    space = simulator.nominal.space
    for number, size in enumerate(_DIFFERENCE * (space.high - space.low)):
        moved = parameters.copy()
        moved[number] += size
        columns.append((simulator.predict_quickly(moved, causes, states) - quickly) / size)
    own = simulator.base.opt.integrator
    finer, other = (
        simulator.predict_finer(parameters, causes, states, FINER, integrator)
        for integrator in (own, other_integrator(own))
    )
    columns += [finer - predicted, other - finer]
    columns += _derivatives(simulator, parameters, causes, states)
    free = simulator.predict_free(parameters, causes, states)
    stiff = np.any(np.abs(free - quickly) > _TOUCHED * _spread(simulator), axis=1)
    everything = np.concatenate([residual[..., None], transition, np.stack(columns, axis=2)], 2)
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
    chain = Chain(mask, folded[..., 1 : m + 1], layout.fold(stiff), measured)
    return _known_before(chain, folded[..., 0], folded[..., m + 1 :], len(parameters))


def _known_before(chain: Chain, residual: Array3, columns: np.ndarray, parameters: int) -> Linear:
    """Nothing of parameters and causes, something of integration."""
    mean, precision = np.zeros(columns.shape[3]), np.zeros(columns.shape[3])
    for where, (likely, deviation) in enumerate(_INTEGRATION, parameters):
        mean[where], precision[where] = likely, 1 / deviation**2
    return Linear(chain, residual, columns, mean, precision)


def _first_noise(linear: Linear, sensor: Vector) -> Noise:
    """A guess, from what the columns leave."""
    mask, p = linear.chain.mask, linear.columns.shape[3]
    rows = linear.columns[mask].reshape(-1, p)
    change = np.linalg.lstsq(rows, linear.residual[mask].ravel(), rcond=None)[0]
    return at_start(linear.chain, linear.residual - linear.columns @ change, sensor)


def _derivatives(
    simulator: Simulator, parameters: Vector, causes: tuple[Cause, ...], states: Matrix
) -> list[Matrix]:
    """Derivatives (N, m) of the prediction by each strength of each cause.

    The smaller of the slopes to both sides, where a strength has two: a contact that begins or
    ends in between would make the one side infinitely steep. Of several strengths, those that the
    data say nothing of are zero and stay so.
    """
    if not causes:
        return []
    predicted = simulator.predict_quickly(parameters, causes, states)
    found: list[Matrix] = []
    for cause in causes:
        mechanism = get_mechanism(cause.kind)
        typical = mechanism.typical(simulator.base, element_of(simulator.base, cause.location))
        for number, size in enumerate(typical):
            if len(typical) > 1 and cause.values[number] == 0:
                found.append(np.zeros_like(predicted))
                continue
            slopes: list[Matrix] = []
            for step in (0.01 * size, -0.01 * size):
                values = list(cause.values)
                values[number] += step
                if values[number] < mechanism.strengths[number].low:
                    continue
                moved = replace(cause, values=tuple(values))
                changed = tuple(moved if each is cause else each for each in causes)
                effect = simulator.predict_quickly(parameters, changed, states) - predicted
                slopes.append(effect / step)
            found.append(_flatter(*slopes))
    return found


def _flatter(one: Matrix, other: Matrix | None = None) -> Matrix:
    if other is None:
        return one
    return np.where(np.isnan(one) | (np.abs(other) < np.abs(one)), other, one)


def _strengthened(causes: tuple[Cause, ...], change: Vector) -> tuple[Cause, ...]:
    """Causes with changed strengths, at the edge of what makes sense at most."""
    moved: list[Cause] = []
    for cause in causes:
        count = len(cause.values)
        low = [strength.low for strength in get_mechanism(cause.kind).strengths]
        values = np.maximum(np.array(cause.values) + change[:count], low)
        moved.append(replace(cause, values=tuple(values.tolist())))
        change = change[count:]
    return tuple(moved)


def _moved(simulator: Simulator, parameters: Vector, change: Vector) -> Vector:
    """Parameters after a step, within their bounds; what is positive moves in proportion."""
    space = simulator.nominal.space
    low, high = space.feasible_low, np.maximum(space.high, parameters)
    step = change[: len(parameters)]
    positive = low > 0
    factor = np.exp(np.clip(step / np.where(positive, parameters, 1.0), -2.0, 2.0))
    return np.clip(np.where(positive, parameters * factor, parameters + step), low, high)


def _root(covariance: np.ndarray, tiny: Matrix) -> np.ndarray:
    """Lower triangular roots of covariances (rows, m, m), kept invertible by tiny deviations."""
    scale = np.sqrt(np.maximum(np.diagonal(covariance, axis1=1, axis2=2), 0.0)) + np.diag(tiny)
    outer = scale[:, :, None] * scale[:, None, :]
    values, vectors = np.linalg.eigh((covariance + tiny**2) / outer)
    kept = np.maximum(values, 1e-9)
    sane = (vectors * kept[:, None, :]) @ vectors.swapaxes(1, 2) * outer
    return np.linalg.cholesky(sane)


def _tiny(simulator: Simulator) -> Matrix:
    """A root (m, m) of a state's covariance that is too small to matter."""
    return np.diag(_TINY * _spread(simulator))


def _spread(simulator: Simulator) -> Vector:
    """(m,) of each state over the recording."""
    return np.maximum(simulator.measured.std(axis=0), 1e-3)
