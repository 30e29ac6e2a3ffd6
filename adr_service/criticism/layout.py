"""Transitions of a measurement, arranged by episode."""

from dataclasses import dataclass

import numpy as np

from adr_service.arrays import Indices, Mask
from adr_service.criticism.simulator import Simulator


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
