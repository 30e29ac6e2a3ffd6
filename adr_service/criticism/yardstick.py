"""How much better any force on the joints could predict, whatever its cause.

A ridge regression of the whitened residuals on generalised forces that are smooth or kinked
functions of a joint's position and velocity, of all commands, and of time. Where it predicts
episodes that it has not seen better than the best cause does, that cause is not the whole story.
"""

from dataclasses import replace

import numpy as np

from adr_service.arrays import Matrix, Vector
from adr_service.criticism.evidence import Fit
from adr_service.criticism.linear import Normal, estimate
from adr_service.criticism.noise import Whitener

_RIDGES = (0.01, 0.1, 1.0, 10.0)  # prior precisions, relative to what all data say of a coefficient


def flexible_gains(fit: Fit, sensor: Vector) -> Vector:
    """(E,) nats by episode left out: the best ridge over no force at all."""
    base, known = fit.linear.columns.shape[3], ~np.isnan(sensor)
    columns = np.concatenate([fit.linear.columns, _forces(fit)], axis=3)
    added = np.zeros(columns.shape[3] - base)
    mean = np.concatenate([fit.linear.mean, added])
    plain = np.concatenate([fit.linear.precision, added])
    linear = replace(fit.linear, columns=columns, mean=mean, precision=plain)
    normal = Normal.of(Whitener.of(linear.chain, fit.noise), linear)
    said = np.diagonal(normal.information.sum(axis=0)) * (np.arange(len(mean)) >= base)
    penalised = [plain + ridge * said for ridge in _RIDGES]
    best = max(penalised, key=lambda penalty: replace(normal, precision=penalty).left_out().sum())
    _, with_force = estimate(replace(linear, precision=best), fit.noise, known)
    _, without = estimate(fit.linear, fit.noise, known)
    return with_force.left_out() - without.left_out()


def _forces(fit: Fit) -> np.ndarray:
    """(E, T, m, k) effects of each force on each degree of freedom."""
    simulator, nv = fit.simulator, fit.simulator.base.nv
    predicted = simulator.predict_quickly(fit.parameters, fit.causes, fit.states)
    sizes = 0.01 * simulator.base.dof_M0 / simulator.period
    effects: list[Matrix] = []
    for dof, size in enumerate(sizes.tolist()):
        pushed = simulator.predict_pushed(fit.parameters, fit.causes, fit.states, dof, size)
        response = (pushed - predicted) / size  # (N, m)
        effects.append(response[:, :, None] * _features(fit, dof)[:, None, :])
    folded = fit.layout.fold(np.nan_to_num(np.concatenate(effects, axis=2)))
    folded[~fit.linear.chain.mask] = 0.0
    assert len(effects) == nv
    return folded


def _features(fit: Fit, dof: int) -> Matrix:
    """(N, k) what a force on a degree of freedom may depend on."""
    simulator = fit.simulator
    starts, nv = simulator.starts, simulator.base.nv
    q, v = fit.states[starts, dof], fit.states[starts, nv + dof]
    slow = 0.1 * max(float(v.std()), 1e-6)
    told = simulator.data.ctrl[starts]
    first = np.diff(simulator.data.episode[starts], prepend=-1) != 0
    before = np.where(first[:, None], 0.0, np.roll(told, 1, axis=0))
    time = np.linspace(-1.0, 1.0, len(starts))
    own = [np.ones_like(q), q, v, np.tanh(v / slow), v * np.abs(v), np.maximum(v, 0.0)]
    waves = [f(k * q) for k in (1, 2, 4, 8) for f in (np.sin, np.cos)]
    mixed = [*(told * v[:, None]).T, *(told * time[:, None]).T, *np.abs(told).T]
    kinked = [np.tanh(v / slow) * wave for wave in waves]  # friction that depends on where it is
    return np.stack([*own, *waves, *kinked, time, *told.T, *before.T, *mixed], axis=1)
