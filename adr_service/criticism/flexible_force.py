"""A flexible force on the joints, which may predict better than any named effect.

A ridge regression of the whitened residuals on generalised forces that are smooth or kinked
functions of a joint's position and velocity, of all commands, and of time, and on one force that
swings at the frequency at which residuals do most. Where it predicts episodes that it has not seen
better than the named effects do, these are not the whole story.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from adr_service.arrays import Array3, Matrix, Vector
from adr_service.criticism.evidence import Fit
from adr_service.criticism.linear import Normal, estimate
from adr_service.criticism.noise import Whitener

_PADDED = 4  # times as many frequencies as the recording resolves
_SLOWEST = 3  # swings in a recording; less is a drift
_RIDGES = (0.01, 0.1, 1.0, 10.0)  # prior precisions, relative to the information in all data


def flexible_gains(fit: Fit, sensor: Vector) -> Vector:
    """(E,) nats by episode left out: the best ridge over no force at all."""
    base, known = fit.linear.columns.shape[3], ~np.isnan(sensor)
    responses = _responses(fit)
    forces = [
        *(r[:, :, None] * _features(fit, dof)[:, None, :] for dof, r in enumerate(responses)),
        _swing(fit, responses),
    ]
    folded = fit.layout.fold(np.concatenate(forces, axis=2))
    folded[~fit.linear.chain.mask] = 0.0
    columns = np.concatenate([fit.linear.columns, folded], axis=3)
    nothing = np.zeros(columns.shape[3] - base)
    mean = np.concatenate([fit.linear.mean, nothing])
    plain = np.concatenate([fit.linear.precision, nothing])
    linear = replace(fit.linear, columns=columns, mean=mean, precision=plain)
    normal = Normal.of(Whitener.of(linear.chain, fit.noise), linear)
    information = np.diagonal(normal.information.sum(axis=0)) * (np.arange(len(mean)) >= base)
    penalised = [plain + ridge * information for ridge in _RIDGES]
    best = max(penalised, key=lambda penalty: replace(normal, precision=penalty).left_out().sum())
    _, with_force = estimate(replace(linear, precision=best), fit.noise, known)
    _, without = estimate(fit.linear, fit.noise, known)
    return with_force.left_out() - without.left_out()


def _responses(fit: Fit) -> list[Matrix]:
    """(N, m) response to a unit of force on each degree of freedom; zero where it diverges."""
    simulator = fit.simulator
    known = (fit.parameters, fit.effects, fit.states)
    predicted = simulator.predict_quickly(*known)
    sizes = 0.01 * simulator.base.dof_M0 / simulator.period
    return [
        np.nan_to_num(simulator.predict_pushed(*known, dof, size) - predicted) / size
        for dof, size in enumerate(sizes.tolist())
    ]


def _swing(fit: Fit, responses: Sequence[Matrix]) -> Array3:
    """(N, m, 2) effects of a sine and a cosine, at the degree of freedom and the frequency where
    the log-likelihood rises most; episodes are taken as parts of one recording.

    Both are chosen from all episodes. By that choice, chance gains about 10 nats (the logarithm of
    the number of choices).
    """
    simulator, layout, chain = fit.simulator, fit.layout, fit.linear.chain
    whitener = Whitener.of(chain, fit.noise)
    adjoint = whitener.adjoint(whitener.whiten(fit.left[..., None])[..., 0])
    folded = np.stack([layout.fold(r) for r in responses], axis=3)
    folded[~chain.mask] = 0.0
    pull = np.einsum("etmd,etm->det", folded, adjoint)
    information = np.sum(whitener.whiten(folded) ** 2, axis=(0, 1, 2))  # (d,) on a unit force
    rows = np.zeros((len(responses), _PADDED * len(simulator.data.time)))
    rows[:, simulator.starts] = np.nan_to_num(pull[:, layout.mask])
    power = np.abs(np.fft.rfft(rows)) ** 2
    power /= np.maximum(information, 1e-300)[:, None]
    power[:, : _SLOWEST * _PADDED] = 0.0
    dof, wave = np.unravel_index(np.argmax(power), power.shape)
    angle = 2 * np.pi * int(wave) / rows.shape[1] * simulator.starts
    return (
        responses[int(dof)][:, :, None] * np.column_stack([np.sin(angle), np.cos(angle)])[:, None]
    )


def _features(fit: Fit, dof: int) -> Matrix:
    """(N, k) functions that a force on a degree of freedom may be a sum of."""
    simulator = fit.simulator
    starts, nv = simulator.starts, simulator.base.nv
    q, v = fit.states[starts, dof], fit.states[starts, nv + dof]
    slow = 0.1 * max(float(v.std()), 1e-6)
    commands = simulator.data.ctrl[starts]
    first = np.diff(simulator.data.episode[starts], prepend=-1) != 0
    before = np.where(first[:, None], 0.0, np.roll(commands, 1, axis=0))
    time = np.linspace(-1.0, 1.0, len(starts))
    own = [np.ones_like(q), q, v, np.tanh(v / slow), v * np.abs(v), np.maximum(v, 0.0)]
    waves = [f(k * q) for k in (1, 2, 4, 8) for f in (np.sin, np.cos)]
    mixed = [
        *(commands * v[:, None]).T,
        *(commands * time[:, None]).T,
        *np.abs(commands).T,
    ]
    kinked = [np.tanh(v / slow) * wave for wave in waves]  # friction that depends on where it is
    return np.stack([*own, *waves, *kinked, time, *commands.T, *before.T, *mixed], axis=1)
