"""Published data sets, read where they lie."""

from pathlib import Path

import numpy as np

from adr_service.tasks.catalogue import get_task
from adr_service.transitions import TransitionDataset

HOPPER_MASSES_KG = (3.53429174, 3.92699082, 2.71433605, 5.0893801)  # the authors' README


def load_hopper(folder: Path, prefix: str) -> TransitionDataset:
    """DROPO's Hopper transitions (gabrieletiboni/dropo, MIT licence)."""
    arrays = {
        name: np.load(folder / f"{prefix}_{name}.npy")
        for name in ("observations", "actions", "nextobservations", "terminals")
    }
    ends = np.cumsum(arrays["terminals"])
    return TransitionDataset(
        observations=arrays["observations"],
        actions=arrays["actions"],
        next_observations=arrays["nextobservations"],
        episodes=np.concatenate([[0], ends[:-1]]).astype(np.int64),
        dt=0.008,
        columns=get_task("hopper").columns,
        origin=f"gabrieletiboni/dropo {prefix}",
    )
