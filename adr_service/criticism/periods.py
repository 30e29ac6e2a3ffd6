"""What residuals ask for of a force that repeats: in time, or with the angle of a joint.

    pull = pulls(fit, responses)             # (nv, N), of one deviation each by noise alone
    power = power_of(pull, rows)             # squared Fourier sums
    waves_in_turn(fit, responses)            # {"joint:elbow": 12.1}

`responses` are what a unit of force on each degree of freedom changes of a prediction, (N, m) each.
"""

from collections.abc import Sequence

import mujoco
import numpy as np

from adr_service.arrays import Indices, Matrix
from adr_service.criticism.evidence import Fit
from adr_service.criticism.noise import Whitener

PADDED = 4  # times as many frequencies as a record resolves
_FEWEST = 2  # waves in a joint's motion and in a turn; fewer are a spring, or a weight
_MOST = 400.0  # waves in a turn
_BINS = 8  # of angles, in the shortest wave


def pulls(fit: Fit, responses: Sequence[Matrix]) -> Matrix:
    """(nv, N) how much the residuals of each transition ask for a force on each degree of freedom;
    a sum over transitions is of one standard deviation if all are noise."""
    layout, chain = fit.layout, fit.linear.chain
    whitener = Whitener.of(chain, fit.noise)
    adjoint = whitener.adjoint(whitener.whiten(fit.left[..., None])[..., 0])
    folded = np.stack([layout.fold(r) for r in responses], axis=3)
    folded[~chain.mask] = 0.0
    pull = np.nan_to_num(np.einsum("etmd,etm->det", folded, adjoint)[:, layout.mask])
    information = np.sum(whitener.whiten(folded) ** 2, axis=(0, 1, 2))  # (d,) on a unit force
    return pull / np.sqrt(np.maximum(information, 1e-300))[:, None]


def power_of(pull: Matrix, where: Indices) -> Matrix:
    """(d, F) squared Fourier sums of pulls (d, N) at these places, which several may share."""
    size = PADDED * (int(where.max()) + 1)
    rows = np.stack([np.bincount(where, each, size) for each in pull])
    return np.abs(np.fft.rfft(rows)) ** 2


def waves_in_turn(fit: Fit, responses: Sequence[Matrix]) -> dict[str, float]:
    """For each hinge, how often in a turn that force repeats which its residuals ask for most."""
    model, starts, pull = fit.simulator.base, fit.simulator.starts, pulls(fit, responses)
    found: dict[str, float] = {}
    for dof, joint in enumerate(model.dof_jntid.tolist()):
        if model.jnt_type[joint] != mujoco.mjtJoint.mjJNT_HINGE:
            continue
        before, after = fit.states[starts, dof], fit.predicted[:, dof]
        angles = np.where(np.isfinite(after), (before + after) / 2, before)  # some may diverge
        width = 2 * np.pi / (_BINS * _MOST)
        where = ((angles - angles.min()) / width).astype(np.int64)
        power = power_of(pull[dof : dof + 1], where)[0]
        waves = np.arange(len(power)) * 2 * np.pi / (PADDED * width * (int(where.max()) + 1))
        first, last = np.searchsorted(waves, [_FEWEST, _MOST]).tolist()
        asked = slice(max(first, _FEWEST * PADDED), last)
        if power[asked].size:
            found[f"joint:{model.joint(joint).name}"] = float(waves[asked][power[asked].argmax()])
    return found
