"""Forces that repeat, in time or with the angle of a joint, as residuals ask for them.

    response = responses.to_unit("joint_torque_ripple", "joint:elbow")
    pulls(baseline, [response])                            # (1, N)
    waves_in_turn(baseline, {"joint:elbow": response})     # {"joint:elbow": 12.1}

The responses are what a unit of each of d forces, or frictions, changes of a prediction, (N, m)
each.
"""

from collections.abc import Mapping, Sequence

import numpy as np

from adr_service.arrays import Indices, Matrix
from adr_service.criticism.fits import Fit
from adr_service.criticism.noise import Whitener
from adr_service.effects.models import element_of

PADDED = 4  # times as many frequencies as a record resolves
_FEWEST = 2  # waves in a joint's motion and in a turn; fewer are a spring, or a weight
_MOST = 400.0  # waves in a turn: a harmonic drive of 100:1 has 200, and their second harmonic
_BINS = 8  # of angles, in the shortest wave
_MOST_BINS = 2**18  # in a joint's motion; one that turns further is asked for fewer waves


def pulls(fit: Fit, responses: Sequence[Matrix]) -> Matrix:
    """Derivatives (d, N) of the log-likelihood by each force during each transition, scaled so that
    their sum over transitions has a deviation of one by noise alone."""
    layout, chain = fit.layout, fit.linear.chain
    whitener = Whitener.of(chain, fit.noise)
    adjoint = whitener.adjoint(whitener.whiten(fit.left[..., None])[..., 0])
    folded = np.stack([layout.fold(r) for r in responses], axis=3)
    folded[~chain.mask] = 0.0
    pull = np.nan_to_num(np.einsum("etmd,etm->det", folded, adjoint)[:, layout.mask])
    information = np.sum(whitener.whiten(folded) ** 2, axis=(0, 1, 2))  # (d,) on a unit force
    return pull / np.sqrt(np.maximum(information, 1e-300))[:, None]


def power_of(pull: Matrix, where: Indices, size: int) -> Matrix:
    """(d, size // 2 + 1) squared Fourier sums of pulls (d, N) at these places below `size`, which
    several may share."""
    rows = np.stack([np.bincount(where, each, size) for each in pull])
    return np.abs(np.fft.rfft(rows)) ** 2


def waves_in_turn(fit: Fit, responses: Mapping[str, Matrix]) -> dict[str, float]:
    """Number of waves in a turn, by hinge, of the periodic force that explains most of what the fit
    leaves; no entry for a hinge that moves by less than two of the shortest waves."""
    base, pull = fit.simulator.base, pulls(fit, list(responses.values()))
    kept = fit.linear.chain.mask[fit.layout.mask]  # (N,) those that do not diverge
    found: dict[str, float] = {}
    for number, hinge in enumerate(responses):
        dof = int(base.jnt_dofadr[element_of(base, hinge)])
        angles = (fit.states[fit.simulator.starts, dof] + fit.predicted[:, dof])[kept] / 2
        width = max(2 * np.pi / (_BINS * _MOST), float(np.ptp(angles)) / _MOST_BINS)
        where = ((angles - angles.min()) / width).astype(np.int64)
        size = 1 << (PADDED * (int(where.max()) + 1)).bit_length()  # a power of two: fast
        power = power_of(pull[number : number + 1, kept], where, size)[0]
        waves = 2 * np.pi / width * np.arange(len(power)) / size
        resolved = _FEWEST * 2 * np.pi / (width * (int(where.max()) + 1))
        most = min(_MOST, 2 * np.pi / (_BINS * width))
        asked = (waves >= max(resolved, _FEWEST)) & (waves <= most)
        if asked.any():
            found[hinge] = float(waves[asked][power[asked].argmax()])
    return found
