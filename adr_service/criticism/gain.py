"""What an extension is worth on episodes that nothing was fitted to."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from adr_service.arrays import Array3, Matrix, Vector
from adr_service.causes import Cause
from adr_service.criticism.evidence import Fit, expected_errors, residuals_of
from adr_service.criticism.measurements import Measurement
from adr_service.criticism.noise import Ascent, Chain, Noise, Whitener
from adr_service.criticism.simulator import Simulator
from adr_service.criticism.verdict import Gain, Trace

_HORIZONS = (1, 5, 25)  # control steps
_DRAWS = 1000
_WEIGHINGS = 5


def measure_gain(
    before: Fit,
    after: Fit,
    sealed: Measurement,
    rng: np.random.Generator,
    threads: int | None = None,
) -> Gain:
    """Of one step, innovations: what a Kalman filter with the final noise did not see coming. Of
    more steps, errors from measured states."""
    nominal, finer = before.simulator.nominal, before.simulator.finer
    with Simulator(nominal, sealed, threads, finer) as simulator:
        scale = expected_errors(after)
        left = [residuals_of(fit, simulator) for fit in (before, after)]
        errors = [
            _errors(simulator, fit.parameters, fit.causes, max(_HORIZONS), scale)
            for fit in (before, after)
        ]
        trace = _trace(simulator, before, after)
    used = [int(chain.mask.sum()) for chain, _ in left]
    count = len(simulator.starts)
    for one, other in zip(*errors, strict=True):  # what either cannot predict says nothing of both
        one[np.isnan(other)], other[np.isnan(one)] = np.nan, np.nan
    mask, measured = left[0][0].mask & left[1][0].mask, simulator.data.is_measured()
    both = [(chain.where(mask), np.where(mask[..., None], r, 0.0)) for chain, r in left]
    # an outlier is what neither of the two expects
    weights = np.maximum(*(_weights(*each, after.noise) for each in both))
    noise = replace(after.noise, weights=weights)
    white = (Whitener.of(chain, noise).whiten(r[..., None])[..., 0] for chain, r in both)
    without, with_causes = (np.sum(z[..., measured] ** 2, axis=(1, 2)) for z in white)
    draws = rng.integers(len(without), size=(_DRAWS, len(without)))
    removed = 1 - with_causes[draws].sum(axis=1) / without[draws].sum(axis=1)
    low, high = np.quantile(removed, [0.025, 0.975]).tolist()
    # noise alone leaves one per number, or less where outliers weigh less
    noise_alone = min(float(mask.sum() * measured.sum()), float(with_causes.sum()))
    explainable = without.sum() - noise_alone
    horizons = {
        steps: (_root_mean(errors[0][steps - 1]), _root_mean(errors[1][steps - 1]))
        for steps in _HORIZONS
        if np.isfinite(errors[0][steps - 1]).any()  # some episode is as long as that
    }
    return Gain(
        sse_removed=float(1 - with_causes.sum() / without.sum()),
        low=low,
        high=high,
        explainable_fraction=(
            float((without.sum() - with_causes.sum()) / explainable) if explainable > 0 else None
        ),
        horizons=horizons,
        diverged=(count - used[0], count - used[1]),
        trace=trace,
    )


def _root_mean(squares: Matrix) -> float:
    return float(np.sqrt(np.nanmean(squares)))


def _trace(simulator: Simulator, before: Fit, after: Fit) -> Trace:
    """The longest episode, as far as the farthest horizon."""
    first, last = max(simulator.data.spans(), key=lambda span: span[1] - span[0])
    rows = slice(first, min(last, first + max(_HORIZONS) + 1))
    without, with_causes = (
        simulator.follow(fit.parameters, fit.causes)[rows] for fit in (before, after)
    )
    time = simulator.data.time[rows] - simulator.data.time[first]
    return Trace(time, simulator.measured[rows], without, with_causes)


def _weights(chain: Chain, residual: Array3, noise: Noise) -> Matrix:
    """(E, T) of the t distribution, under the noise of other data."""
    weights = np.ones(chain.mask.shape)
    for _ in range(_WEIGHINGS):
        whitener = Whitener.of(chain, replace(noise, weights=weights))
        weights = Ascent.of(whitener, residual).weights
    return weights


def _errors(
    simulator: Simulator,
    parameters: Vector,
    causes: Sequence[Cause],
    horizon: int,
    scale: Vector,
) -> list[Matrix]:
    """Squared errors (N, m) after 1 .. horizon control steps, in units of `scale`; NaN past the
    end of an episode, or where the simulation diverged."""
    starts, measured = simulator.starts, simulator.measured
    states, known = measured.copy(), np.ones(len(measured), dtype=np.bool_)
    found: list[Matrix] = []
    for _ in range(horizon):
        here = np.where(known[:, None], states, measured)
        predicted = simulator.predict(parameters, causes, here)
        error = ((predicted - measured[starts + 1]) / scale) ** 2
        error[~known[starts]] = np.nan
        found.append(error)
        followed = known[starts] & np.all(np.isfinite(predicted), axis=1)
        states, known = measured.copy(), np.zeros(len(measured), dtype=np.bool_)
        states[starts[followed] + 1], known[starts[followed] + 1] = predicted[followed], True
    return found
