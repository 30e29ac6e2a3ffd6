"""What an extension is worth on episodes that nothing was fitted to."""

from collections.abc import Sequence

import numpy as np

from adr_service.arrays import Matrix, Vector
from adr_service.causes import Cause
from adr_service.criticism.evidence import Fit
from adr_service.criticism.measurements import Measurement
from adr_service.criticism.noise import misfit_variance
from adr_service.criticism.simulator import Simulator
from adr_service.criticism.verdict import Gain

_HORIZONS = (1, 5, 25)  # control steps
_DRAWS = 1000


def measure_gain(
    before: Fit,
    after: Fit,
    sealed: Measurement,
    rng: np.random.Generator,
    threads: int | None = None,
) -> Gain:
    """Errors of one and more control steps, without and with the causes, from measured states."""
    nominal, finer = before.simulator.nominal, before.simulator.finer
    with Simulator(nominal, sealed, threads, finer) as simulator:
        expected, noise = _expected_errors(after)
        measured = simulator.data.is_measured()
        scale = np.where(measured, np.sqrt(expected), np.nan)  # no error of what was not measured
        errors = [
            _errors(simulator, fit.parameters, fit.causes, max(_HORIZONS), scale)
            for fit in (before, after)
        ]
    episodes = simulator.data.episode[simulator.starts]
    diverged = [int(np.isnan(e[0][:, measured]).any(axis=1).sum()) for e in errors]
    for one, other in zip(*errors, strict=True):  # what either cannot predict says nothing of both
        one[np.isnan(other)], other[np.isnan(one)] = np.nan, np.nan
    without, with_causes = (_by_episode(np.nan_to_num(e[0]), episodes) for e in errors)
    floor = _by_episode(np.isfinite(errors[0][0]) * (noise / expected), episodes)
    draws = rng.integers(len(without), size=(_DRAWS, len(without)))
    removed = 1 - with_causes[draws].sum(axis=1) / without[draws].sum(axis=1)
    low, high = np.quantile(removed, [0.025, 0.975]).tolist()
    explainable = without.sum() - floor.sum()  # which sensors' noise alone would leave
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
        diverged=(diverged[0], diverged[1]),
    )


def _root_mean(squares: Matrix) -> float:
    return float(np.sqrt(np.nanmean(squares)))


def _expected_errors(fit: Fit) -> tuple[Vector, Vector]:
    """Typical squares (m,) of a one-step error by a fit: in all, and of sensors' noise alone."""
    transition, mask = fit.linear.chain.transition, fit.linear.chain.mask
    noise = (transition[mask] ** 2) @ fit.noise.sensor + fit.noise.sensor
    misfit = misfit_variance(fit.linear.chain, fit.noise)[mask]
    return np.median(noise + misfit, axis=0), np.median(noise, axis=0)


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


def _by_episode(values: Matrix, episodes: np.ndarray) -> Vector:
    """Sums over each episode."""
    _, numbers = np.unique(episodes, return_inverse=True)
    return np.bincount(numbers, weights=values.sum(axis=1)).astype(np.float64)
