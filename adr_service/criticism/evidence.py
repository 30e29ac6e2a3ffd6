"""How much better the data are predicted with a cause than without it.

    baseline = fit(simulator, sensor, start)           # free parameters, noise, smoothed states
    found = scan(baseline, places(simulator))         # every (kind, location), linearised
    refined = refine(baseline, [found[0].cause], sensor)      # nonlinear, with its own noise

All fits are Gauss-Newton steps on whitened one-step residuals around smoothed states. A gain is
the log-likelihood, in nats, of episodes that were left out one at a time from the fit, with the
cause minus without. What the free parameters can explain is not evidence: they are fitted in both;
nor is what a smaller simulator step would change, which is fitted as if it were a parameter.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from adr_service.arrays import Array3, Indices, Mask, Matrix, Vector
from adr_service.criticism.noise import Chain, Noise, Whitener, at_start, estimate
from adr_service.criticism.simulator import Simulator, other_integrator
from adr_service.errors import InvalidInput
from adr_service.simulation.mechanisms import Cause, element_of, get_mechanism

FINER = 3  # how much smaller a step shows what numerical integration adds
# how much of what a finer step changes is really there, and of what another integrator changes at
# that step: prior means and deviations. Nothing, where the data were simulated alike; 4/3 of the
# first, where they are real and the integrator is of first order
_INTEGRATION = ((2 / 3, 2 / 3), (0.0, 1.0))
INTEGRATION = len(_INTEGRATION)  # columns
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
class Linear:
    """Residuals of all transitions, and how they would change."""

    chain: Chain
    residual: Array3  # (E, T, m)
    columns: np.ndarray  # (E, T, m, p) of parameters, then of integration, of causes' strengths
    parameters: int  # how many


@dataclass(frozen=True)
class Normal:
    """Normal equations of each episode: log-likelihoods as functions of a small change."""

    information: np.ndarray  # (E, p, p)
    score: Matrix  # (E, p)
    log_likelihood: Vector  # (E,) at no change

    @classmethod
    def of(cls, whitener: Whitener, linear: Linear) -> "Normal":
        z = whitener.whiten(np.concatenate([linear.residual[..., None], linear.columns], axis=3))
        log_likelihood = whitener.log_likelihood(z[..., 0])
        inner = products(z[..., 1:], z)
        information, score = inner[..., 1:], inner[..., 0]
        for where, (mean, deviation) in enumerate(_INTEGRATION, linear.parameters):
            information[:, where, where] += 1 / deviation**2 / len(z)
            score[:, where] += mean / deviation**2 / len(z)
        return cls(information, score, log_likelihood)

    def with_columns(self, own: np.ndarray, cross: np.ndarray, score: Matrix) -> "Normal":
        """More columns: their information (E, k, k), that with ours (E, p, k), score (E, k)."""
        top = np.concatenate([self.information, cross], axis=2)
        bottom = np.concatenate([cross.swapaxes(1, 2), own], axis=2)
        information = np.concatenate([top, bottom], axis=1)
        return Normal(information, np.concatenate([self.score, score], axis=1), self.log_likelihood)

    def change(self, penalty: Vector | float = 0.0) -> tuple[Vector, Matrix]:
        """The most probable change (p,), and its covariance (p, p).

        `penalty` (p,) is the prior precision of each, zero: nothing is known before.
        """
        everything = self.information.sum(axis=0)
        covariance = _inverse(everything + np.eye(len(everything)) * penalty)
        return covariance @ self.score.sum(axis=0), covariance

    def covariance(self) -> Matrix:
        """(p, p) of the most probable change, by how much episodes differ about it.

        The sandwich estimate, which holds where residuals are neither Gaussian nor independent
        within an episode (Liang and Zeger, 1986), for few episodes (HC1).
        """
        change, model = self.change()
        apart = self.score - self.information @ change  # (E, p)
        count, p = apart.shape
        return model @ (apart.T @ apart) @ model * count / max(count - p, 1)

    def settled(self, columns: slice) -> float:
        """Log-likelihood of all episodes once these columns alone have changed."""
        information = self.information[:, columns, columns].sum(axis=0)
        score = self.score[:, columns].sum(axis=0)
        return float(self.log_likelihood.sum() + 0.5 * score @ _inverse(information) @ score)

    def left_out(self, penalty: Vector | float = 0.0) -> Vector:
        """(E,) log-likelihood of each episode, by a fit to all the others."""
        rest = self.information.sum(axis=0) - self.information
        rest = rest + np.eye(rest.shape[1]) * penalty
        score = self.score.sum(axis=0) - self.score
        change = np.einsum("eij,ej->ei", _inverse(rest), score)
        bend = np.einsum("ei,eij,ej->e", change, self.information, change)
        return self.log_likelihood + np.einsum("ei,ei->e", self.score, change) - 0.5 * bend


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


def fit(
    simulator: Simulator,
    sensor: Vector,
    parameters: Vector,
    causes: Sequence[Cause] = (),
    rounds: int = 2,
) -> Fit:
    """The simulator at its best with these causes, from `parameters` (d,).

    `sensor` (m,) are the variances of the sensors' noise, NaN where they are not known.
    """
    layout, states, causes = Layout.of(simulator), simulator.measured, tuple(causes)
    tiny = np.diag(_TINY * _spread(simulator))
    root = np.broadcast_to(tiny, (*states.shape, len(tiny)))
    found = _fitted(simulator, layout, parameters, causes, states, root, sensor)
    for _ in range(rounds - 1):
        change, _ = found.normal.change()
        whitener = Whitener.of(found.linear.chain, found.noise)
        errors, covariance = whitener.sensor_errors(
            found.linear.residual - found.linear.columns @ change
        )
        states = simulator.measured - layout.by_row(simulator, errors)
        root = _root(layout.by_row(simulator, covariance), tiny)
        found = _fitted(simulator, layout, found.parameters, found.causes, states, root, sensor)
    return found


def _fitted(
    simulator: Simulator,
    layout: Layout,
    parameters: Vector,
    causes: tuple[Cause, ...],
    states: Matrix,
    root: np.ndarray,
    sensor: Vector,
) -> Fit:
    """The best parameters and strengths around given states, known up to `root`."""
    linear = _linearise(simulator, layout, parameters, causes, states, root)
    noise, normal = _judge(linear, sensor)
    found = Fit(simulator, layout, parameters, causes, states, linear, noise, normal)
    return refine(found, causes, sensor)


def refine(fit: Fit, causes: Sequence[Cause], sensor: Vector, rounds: int = 4) -> Fit:
    """The fit with these causes, from strengths near the best ones; its states stay.

    A step that makes the data less probable is halved. Where these causes let the simulation
    diverge, they explain nothing: the fit comes back as it was. Compare with
    `refine(fit, fit.causes, …)`, whose noise had as many rounds to settle.
    """
    before = fit.simulator.predict(fit.parameters, fit.causes, fit.states)
    integration = slice(len(fit.parameters), len(fit.parameters) + INTEGRATION)
    best = _evaluated(fit, before, fit.parameters, tuple(causes), fit.noise, sensor)
    if best is None:
        return fit
    step = best.normal.change()[0]
    for _ in range(rounds - 1):
        parameters = _moved(fit.simulator, best.parameters, step)
        moved = _strengthened(best.causes, step[integration.stop :])
        tried = _evaluated(fit, before, parameters, moved, best.noise, sensor)
        if tried is not None and tried.normal.settled(integration) > best.normal.settled(
            integration
        ):
            best, step = tried, tried.normal.change()[0]
        else:
            step = step / 2
    return best


def _evaluated(
    fit: Fit,
    before: Matrix,
    parameters: Vector,
    causes: tuple[Cause, ...],
    noise: Noise,
    sensor: Vector,
) -> Fit | None:
    """Another fit's states and sensitivities, with other parameters and causes.

    `before` is what the other fit predicts. None: some transition diverges.
    """
    simulator, layout, count = fit.simulator, fit.layout, len(parameters)
    predicted = simulator.predict(parameters, causes, fit.states)
    effects = [
        effect
        for each in causes
        for effect in _derivatives(simulator, parameters, causes, each, fit.states, predicted)
    ]
    moved = layout.fold(np.stack([predicted - before, *effects], axis=2))
    moved[~fit.linear.chain.mask] = 0.0
    if not np.all(np.isfinite(moved)):
        return None
    linear = Linear(
        fit.linear.chain,
        fit.linear.residual - moved[..., 0],
        np.concatenate([fit.linear.columns[..., : count + INTEGRATION], moved[..., 1:]], axis=3),
        count,
    )
    noise, normal = _judge_again(linear, noise, sensor, rounds=(4,))
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
    slopes, mean = np.empty((len(starts), m, m)), predicted.copy()
    for column in range(m):
        step = root[:, :, column]
        above = simulator.predict(parameters, causes, states + step)
        below = simulator.predict(parameters, causes, states - step)
        slopes[:, :, column] = (above - below) / 2
        mean += (above + below) / 2 - predicted
    transition = slopes @ np.linalg.inv(root[starts])
    offset = (simulator.measured - states)[starts]
    residual = simulator.measured[starts + 1] - mean - (transition @ offset[..., None])[..., 0]
    columns: list[Matrix] = []
    space = simulator.nominal.space
    for number, size in enumerate(_DIFFERENCE * (space.high - space.low)):
        moved = parameters.copy()
        moved[number] += size
        columns.append((simulator.predict(moved, causes, states) - predicted) / size)
    own = simulator.base.opt.integrator
    finer, other = (
        simulator.predict_finer(parameters, causes, states, FINER, integrator)
        for integrator in (own, other_integrator(own))
    )
    columns += [finer - predicted, other - finer]
    for cause in causes:
        columns += _derivatives(simulator, parameters, causes, cause, states, predicted)
    free = simulator.predict_free(parameters, causes, states)
    stiff = np.any(np.abs(free - predicted) > _TOUCHED * _spread(simulator), axis=1)
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
    chain = Chain(mask, folded[..., 1 : m + 1], layout.fold(stiff))
    return Linear(chain, folded[..., 0], folded[..., m + 1 :], len(parameters))


def _judge(linear: Linear, sensor: Vector) -> tuple[Noise, Normal]:
    """The noise of what the columns leave, and the normal equations under it."""
    mask, p = linear.chain.mask, linear.columns.shape[3]
    rows = linear.columns[mask].reshape(-1, p)
    change = np.linalg.lstsq(rows, linear.residual[mask].ravel(), rcond=None)[0]
    left = linear.residual - linear.columns @ change
    start = at_start(linear.chain, left, sensor)
    noise = estimate(linear.chain, left, start, 8, ~np.isnan(sensor))
    return _judge_again(linear, noise, sensor, rounds=(8, 10))


def _judge_again(
    linear: Linear, noise: Noise, sensor: Vector, rounds: Sequence[int]
) -> tuple[Noise, Normal]:
    normal = Normal.of(Whitener.of(linear.chain, noise), linear)
    for count in rounds:
        change, _ = normal.change()
        left = linear.residual - linear.columns @ change
        noise = estimate(linear.chain, left, noise, count, ~np.isnan(sensor))
        normal = Normal.of(Whitener.of(linear.chain, noise), linear)
    return noise, normal


def _derivatives(
    simulator: Simulator,
    parameters: Vector,
    causes: tuple[Cause, ...],
    cause: Cause,
    states: Matrix,
    predicted: Matrix,
) -> list[Matrix]:
    """Derivatives (N, m) of the prediction by each strength of one of the causes.

    Of several strengths, those that the data say nothing of are zero and stay so.
    """
    mechanism = get_mechanism(cause.kind)
    typical = mechanism.typical(simulator.base, element_of(simulator.base, cause.location))
    found: list[Matrix] = []
    for number, size in enumerate(typical):
        if len(typical) > 1 and cause.values[number] == 0:
            found.append(np.zeros_like(predicted))
            continue
        step = 0.01 * size
        values = list(cause.values)
        values[number] += step
        moved = replace(cause, values=tuple(values))
        changed = tuple(moved if each is cause else each for each in causes)
        found.append((simulator.predict(parameters, changed, states) - predicted) / step)
    return found


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


def _spread(simulator: Simulator) -> Vector:
    """(m,) of each state over the recording."""
    return np.maximum(simulator.measured.std(axis=0), 1e-3)


def products(one: np.ndarray, other: np.ndarray) -> np.ndarray:
    """(E, i, j) inner products of columns (E, T, m, i) and (E, T, m, j), by episode."""
    e, t, m, i = one.shape
    return one.reshape(e, t * m, i).swapaxes(1, 2) @ other.reshape(e, t * m, -1)


def _inverse(information: np.ndarray) -> np.ndarray:
    """Pseudo-inverse of normal matrices (..., p, p), whose columns may differ by many orders."""
    scale = np.sqrt(np.maximum(np.diagonal(information, axis1=-2, axis2=-1), 1e-300))
    outer = scale[..., :, None] * scale[..., None, :]
    return np.linalg.pinv(information / outer, rcond=1e-9, hermitian=True) / outer
