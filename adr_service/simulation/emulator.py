"""A polynomial that stands for a replay inside a box of dynamics, and knows how well.

    emulator = Emulator.fit(replay, low, high, rng)
    predictions = emulator.predict(draws)        # (n, w, s), as replay.predict, where covered
    emulator.error                               # (w, s) root mean square on held-out simulations

Next observations are smooth in the parameters but for contacts that begin or end, so a
polynomial per window is exact to far below a sensor's noise in a small box, and not in a large
one: `error` says which.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations_with_replacement

import numpy as np
from scipy.stats import qmc

from adr_service.arrays import Array3, Indices, Matrix, Vector
from adr_service.simulation.replay import Replay

_PER_COEFFICIENT = 2  # simulations, so that noise of contacts is averaged, not followed
_CHECKS = 16  # held-out simulations
_MOST_COEFFICIENTS = 200  # beyond, the degree is lowered: simulations grow with it


@dataclass(frozen=True)
class Emulator:
    _box: "_Box"
    error: Matrix  # (w, s) root mean square on held-out simulations
    simulated: int  # draws of dynamics that were replayed to fit and to check
    diverged: int  # of those, draws that diverged in some window
    _powers: Sequence[Indices]  # the factors of each monomial
    _coefficients: Matrix  # (p, w * s)

    @classmethod
    def fit(cls, replay: Replay, low: Vector, high: Vector, rng: np.random.Generator) -> "Emulator":
        """Learn the windows of a replay from simulations that fill the box."""
        d, shape = len(low), replay.targets.shape
        powers, count = _monomials(d), draws_to_fit(d)
        unit = qmc.Sobol(d, rng=rng).random(2 ** int(np.ceil(np.log2(count))))[:count]
        box = _Box(low, high)
        simulated = replay.predict(box.at(2 * unit - 1)).reshape(len(unit), -1)
        broken = ~np.isfinite(simulated)
        # a diverged replay tells nothing of its window but, by the error, that it is uncertain
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
        """How much of the box's width draws (n, d) fill, (d,); above 1 where one is outside."""
        unit = self._box.unit(draws)
        farthest = np.abs(unit).max(axis=0)
        return np.where(farthest > 1, farthest, np.ptp(unit, axis=0) / 2)

    def predict(self, draws: Matrix) -> Array3:
        """Emulated observations at each window's end, (n, w, s)."""
        features = _features(self._box.unit(draws), self._powers)
        return (features @ self._coefficients).reshape(-1, *self.error.shape)


@dataclass(frozen=True)
class _Box:
    """[low, high] as [-1, 1]^d; by logarithm where that is possible, for masses act by ratio."""

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
    """Draws of d parameters that one fit replays, with its checks."""
    return _PER_COEFFICIENT * len(_monomials(d)) + _CHECKS


def _monomials(d: int) -> list[Indices]:
    """Every product of at most three (or, in many dimensions, two) coordinates."""
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
