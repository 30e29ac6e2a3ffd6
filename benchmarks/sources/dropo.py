"""DROPO's Hopper: transitions of the authors' simulator, as published with the method.

Tiboni, Arndt and Kyrki, "DROPO: Sim-to-real transfer with offline domain randomization", 2023;
repository gabrieletiboni/dropo, `datasets/hopper10000`: 20 episodes of 500 noise-free transitions
at 125 Hz, of MuJoCo 2.1.0. Observations lack the horizontal position, on which nothing depends; it
is summed up from the velocity, and said not to be measured.
"""

from importlib import resources
from pathlib import Path

import numpy as np

from adr_service.criticism.measurements import Measurement
from adr_service.criticism.nominal import Nominal
from adr_service.errors import InvalidInput
from adr_service.parameters import ParameterSpace

PERIOD_S = 0.008
_EPISODE, _PIECE = 500, 50  # transitions
_POSITIONS = 5  # that are observed
_ROUNDING = 1e-6  # [m, rad, m/s or rad/s] what is taken for exact


def nominal() -> Nominal:
    """Gymnasium's stock `hopper.xml`, of which nothing is free."""
    model = resources.files("gymnasium") / "envs/mujoco/assets/hopper.xml"
    return Nominal.of_model(model.read_text(), ParameterSpace(()))


def read(folder: Path, prefix: str = "hoppermass_n10000", episodes: int = 20) -> Measurement:
    """The first episodes, cut into pieces of 50 transitions that share their ends."""
    try:
        before, after, actions = (
            np.load(folder / f"{prefix}_{name}.npy")
            for name in ("observations", "nextobservations", "actions")
        )
    except (OSError, ValueError) as error:
        raise InvalidInput(f"{folder} has no record {prefix}: {error}") from error
    pieces: list[np.ndarray] = []
    for first in range(0, min(episodes * _EPISODE, len(before)), _PIECE):
        rows = slice(first, first + _PIECE)
        states = np.concatenate([before[rows], after[rows][-1:]])
        travelled = PERIOD_S * np.cumsum(states[:, _POSITIONS])
        told = np.concatenate([actions[rows], np.zeros((1, actions.shape[1]))])
        pieces.append(np.concatenate([travelled[:, None], states, told], axis=1))
    rows, width = np.concatenate(pieces), 1 + before.shape[1]
    return Measurement(
        time=np.tile(PERIOD_S * np.arange(_PIECE + 1, dtype=np.float64), len(pieces)),
        qpos=rows[:, : 1 + _POSITIONS],
        qvel=rows[:, 1 + _POSITIONS : width],
        ctrl=rows[:, width:],
        episode=np.repeat(np.arange(len(pieces)), _PIECE + 1),
        qpos_std=np.array([np.inf, *[_ROUNDING] * _POSITIONS]),
        qvel_std=np.full(1 + _POSITIONS, _ROUNDING),
    )
