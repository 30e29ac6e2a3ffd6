"""A polynomial in place of a replay inside a box of dynamics, with its error.

    emulator = Emulator.fit(replay, low, high, rng)
    predictions = emulator.predict(draws)        # (n, w, s), as replay.predict inside the box
    emulator.error                               # (w, s) root mean square on held-out simulations

Next observations are smooth in the parameters except where contacts begin or end. So a polynomial
per window errs by far less than a sensor's noise in a small box, but not in a large one; `error`
measures it.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations_with_replacement

import numpy as np
from scipy.stats import qmc

from adr_service.arrays import Array3, Indices, Matrix, Vector
from adr_service.simulation.replay import Replay

_PER_COEFFICIENT = 2  # simulations, so that the fit averages the noise of contacts
_CHECKS = 16  # held-out simulations
_MOST_COEFFICIENTS = 200  # with more, the degree is lowered, to need fewer simulations


@dataclass(frozen=True)
class Emulator:
    _box: "_Box"
    error: Matrix  # (w, s) root mean square on held-out simulations
    simulated: int  # draws of dynamics that were replayed for the fit and its check
    diverged: int  # those of them that diverged in some window
    _powers: Sequence[Indices]  # the factors of each monomial
    _coefficients: Matrix  # (p, w * s)

    @classmethod
    def fit(cls, replay: Replay, low: Vector, high: Vector, rng: np.random.Generator) -> "Emulator":
        """Fit a polynomial per window to simulations that fill the box."""
        d, shape = len(low), replay.targets.shape
        powers, count = _monomials(d), draws_to_fit(d)
        unit = qmc.Sobol(d, rng=rng).random(2 ** int(np.ceil(np.log2(count))))[:count]
        box = _Box(low, high)
        simulated = replay.predict(box.at(2 * unit - 1)).reshape(len(unit), -1)
        broken = ~np.isfinite(simulated)
        # the mean in place of a diverged replay: the window's error then grows
        middle = np.where(broken, 0.0, simulated).sum(axis=0) / np.maximum((~broken).sum(axis=0), 1)
        simulated = np.where(broken, middle, simulated)
        features = _features(2 * unit - 1, powers)
        solution = np.linalg.lstsq(features[:-_CHECKS], simulated[:-_CHECKS], rcond=None)
        coefficients = np.asarray(solution[0], dtype=np.float64)
        missed = features[-_CHECKS:] @ coefficients - simulated[-_CHECKS:]
        error = np.sqrt(np.mean(missed**2, axis=0)).reshape(shape)
        diverged = int(broken.any(axis=1).sum())
        return cls(box, error, len(unit), diverged, powers, coefficients)

    def share(self, draws: Matrix) -> Vector:
        """Share of the box's width that draws (n, d) fill, (d,); above 1 if one is outside."""
        unit = self._box.unit(draws)
        farthest = np.abs(unit).max(axis=0)
        return np.where(farthest > 1, farthest, np.ptp(unit, axis=0) / 2)

    def predict(self, draws: Matrix) -> Array3:
        """Emulated observations at each window's end, (n, w, s)."""
        features = _features(self._box.unit(draws), self._powers)
        return (features @ self._coefficients).reshape(-1, *self.error.shape)


@dataclass(frozen=True)
class _Box:
    """The box [low, high] as [-1, 1]^d, logarithmic where positive: masses act by ratios."""

    low: Vector
    high: Vector

    def unit(self, values: Matrix) -> Matrix:
        low, high = self._warp(self.low), self._warp(self.high)
        return 2 * (self._warp(values) - low) / (high - low) - 1

    def at(self, unit: Matrix) -> Matrix:
        low, high = self._warp(self.low), self._warp(self.high)
        warped = low + (unit + 1) / 2 * (high - low)
        return np.where(self.low > 0, np.exp(warped), warped)

    def _warp(self, values: Matrix) -> Matrix:
        safe = np.where(self.low > 0, values, 1.0)
        return np.where(self.low > 0, np.log(np.maximum(safe, 1e-300)), values)


def draws_to_fit(d: int) -> int:
    """Number of draws of d parameters that one fit replays, checks included."""
    return _PER_COEFFICIENT * len(_monomials(d)) + _CHECKS


def _monomials(d: int) -> list[Indices]:
    """All products of at most three coordinates, or of two if there are many coordinates."""
    for degree in (3, 2):
        powers = [
            np.array(factors, dtype=np.int64)
            for k in range(degree + 1)
            for factors in combinations_with_replacement(range(d), k)
        ]
        if len(powers) <= _MOST_COEFFICIENTS or degree == 2:
            return powers
    raise AssertionError("unreachable")


def _features(unit: Matrix, powers: Sequence[Indices]) -> Matrix:
    """Monomials (n, p) of coordinates (n, d) in [-1, 1]."""
    return np.stack([unit[:, factors].prod(axis=1) for factors in powers], axis=1)
