"""The worth of an extension on episodes that nothing was fitted to."""

from dataclasses import replace

import numpy as np
from scipy.stats import t as student

from adr_service.arrays import Array3, Matrix, Vector
from adr_service.criticism.evidence import expected_errors, residuals_of
from adr_service.criticism.fits import Fit
from adr_service.criticism.measurements import Measurement
from adr_service.criticism.noise import Chain, Noise, Whitener
from adr_service.criticism.simulator import Simulator
from adr_service.criticism.variances import Ascent
from adr_service.criticism.verdict import Gain, Trace

_HORIZONS = (1, 5, 25)  # control steps
_BEYOND = 0.025  # probability beyond each end of an interval
_WEIGHINGS = 5

_Residuals = tuple[Chain, Array3]  # (E, T, m) of one fit


def measure_gain(
    before: Fit,
    after: Fit,
    sealed: Measurement,
    threads: int | None = None,
) -> Gain:
    """Errors of two fits on sealed episodes, at least two.

    For one step, innovations: what a Kalman filter with the final noise did not see coming. For
    more steps, errors from measured states.
    """
    with _simulator_of(before, sealed, threads) as simulator:
        left = [residuals_of(fit, simulator) for fit in (before, after)]
        horizons = _horizons(simulator, before, after)
        trace = _trace(simulator, before, after)
    diverged = [len(simulator.starts) - int(chain.mask.sum()) for chain, _ in left]
    without, extended, count = _innovations(left, after.noise, sealed.is_measured()).T
    # noise alone leaves one per number, or less where outliers weigh less
    noise = min(1.0, float(extended.sum() / count.sum()))
    explainable = without - noise * count
    is_noise = explainable.sum() <= _reach(explainable)
    explained = None if is_noise else share_within(without - extended, explainable)
    removed, low, high = share_within(without - extended, without)
    return Gain(
        sse_removed=removed,
        low=low,
        high=high,
        explainable_fraction=explained and explained[0],
        explainable_interval=explained and explained[1:],
        horizons=horizons,
        diverged=(diverged[0], diverged[1]),
        trace=trace,
    )


def share_removed(
    before: Fit,
    after: Fit,
    sealed: Measurement,
    threads: int | None = None,
) -> tuple[float, float, float]:
    """`sse_removed` of `measure_gain`, with its interval, for a fraction of the simulations."""
    with _simulator_of(before, sealed, threads) as simulator:
        left = [residuals_of(fit, simulator) for fit in (before, after)]
    without, extended, _ = _innovations(left, after.noise, sealed.is_measured()).T
    return share_within(without - extended, without)


def share_within(part: Vector, whole: Vector) -> tuple[float, float, float]:
    """The ratio of two sums over episodes (E,), with Student's 95 % interval, both one at most.

    That of the linearised ratio (Cochran, Sampling Techniques, ch. 6). A bootstrap over two
    episodes would end at their two shares.
    """
    share = min(float(part.sum() / whole.sum()), 1.0)  # rounding may make a whole a bit more
    reach = _reach(part - share * whole) / float(whole.sum())
    return share, share - reach, min(share + reach, 1.0)


def _reach(values: Vector) -> float:
    """Half the width of the 95 % interval of a sum over episodes (E,)."""
    count = len(values)
    return float(student.isf(_BEYOND, count - 1) * values.std(ddof=1) * np.sqrt(count))


def _simulator_of(fit: Fit, sealed: Measurement, threads: int | None) -> Simulator:
    return Simulator(fit.simulator.nominal, sealed, threads, fit.simulator.finer)


def _innovations(left: list[_Residuals], noise: Noise, measured: np.ndarray) -> Matrix:
    """(E, 3) squared innovations by one fit, by the other, and their number, over transitions that
    both simulate."""
    mask = left[0][0].mask & left[1][0].mask
    both = [(chain.where(mask), np.where(mask[..., None], r, 0.0)) for chain, r in left]
    # an outlier is what neither of the two expects
    weights = np.maximum(*(_weights(*each, noise) for each in both))
    noise = replace(noise, weights=weights)
    white = (Whitener.of(chain, noise).whiten(r[..., None])[..., 0] for chain, r in both)
    squares = [np.sum(z[..., measured] ** 2, axis=(1, 2)) for z in white]
    return np.column_stack([*squares, mask.sum(axis=1) * measured.sum()])


def _horizons(simulator: Simulator, before: Fit, after: Fit) -> dict[int, tuple[float, float]]:
    """Root mean square errors without and with, by control steps, in expected errors of a step.

    What is not measured has no errors. Where there is such a column, the unit is the extended
    simulator's own error of a step: it starts from inferred states, whose errors nobody knows.
    """
    scale = expected_errors(after)
    if not (measured := simulator.data.is_measured()).all():
        (step,) = _errors(simulator, after, 1, np.ones(len(scale)))
        scale[measured] = np.sqrt(np.nanmean(step[:, measured], axis=0))
    without, extended = (
        [error[:, measured] for error in _errors(simulator, fit, max(_HORIZONS), scale)]
        for fit in (before, after)
    )
    for one, other in zip(without, extended, strict=True):  # compare what both can predict
        one[np.isnan(other)], other[np.isnan(one)] = np.nan, np.nan
    return {
        steps: (_root_mean(without[steps - 1]), _root_mean(extended[steps - 1]))
        for steps in _HORIZONS
        if np.isfinite(without[steps - 1]).any()  # some episode is as long as that
    }


def _root_mean(squares: Matrix) -> float:
    return float(np.sqrt(np.nanmean(squares)))


def _trace(simulator: Simulator, before: Fit, after: Fit) -> Trace:
    """The longest episode, as far as the farthest horizon."""
    first, last = max(simulator.data.spans(), key=lambda span: span[1] - span[0])
    rows = slice(first, min(last, first + max(_HORIZONS) + 1))
    without, extended = (
        simulator.follow(fit.parameters, fit.effects)[rows] for fit in (before, after)
    )
    time = simulator.data.time[rows] - simulator.data.time[first]
    return Trace(time, simulator.measured[rows], without, extended)


def _weights(chain: Chain, residual: Array3, noise: Noise) -> Matrix:
    """(E, T) weights of the t distribution, under the noise of other data."""
    weights = np.ones(chain.mask.shape)
    for _ in range(_WEIGHINGS):
        whitener = Whitener.of(chain, replace(noise, weights=weights))
        weights = Ascent.of(whitener, residual).weights
    return weights


def _errors(simulator: Simulator, fit: Fit, horizon: int, scale: Vector) -> list[Matrix]:
    """Squared errors (N, m) after 1 .. horizon control steps, in units of `scale`; NaN past the
    end of an episode, or where the simulation diverged."""
    starts, measured = simulator.starts, simulator.measured
    states, known = measured.copy(), np.ones(len(measured), dtype=np.bool_)
    errors: list[Matrix] = []
    for _ in range(horizon):
        here = np.where(known[:, None], states, measured)
        predicted = simulator.predict(fit.parameters, fit.effects, here)
        error = ((predicted - measured[starts + 1]) / scale) ** 2
        error[~known[starts]] = np.nan
        errors.append(error)
        followed = known[starts] & np.all(np.isfinite(predicted), axis=1)
        states, known = measured.copy(), np.zeros(len(measured), dtype=np.bool_)
        states[starts[followed] + 1], known[starts[followed] + 1] = predicted[followed], True
    return errors
