"""Evidence for effects: how much better the data are predicted with them than without.

    gains = gained(refine(baseline, [effect]), baseline)        # (E,) nats

A gain is the log-likelihood, in nats, of episodes that were left out one at a time from the fit,
with the effect minus without. What the free parameters can explain is not evidence: they are fitted
in both. Nor is what a smaller simulator step would change, which is fitted as if it were a
parameter.
"""

from collections.abc import Sequence

import numpy as np

from adr_service.arrays import Array3, Vector
from adr_service.criticism.fits import Fit, exact_root, likelier_noise
from adr_service.criticism.layout import Layout
from adr_service.criticism.linear import Linear, Persistence, estimate, persisting
from adr_service.criticism.linearisation import linearise
from adr_service.criticism.noise import Chain, Whitener, misfit_variance
from adr_service.criticism.simulator import Simulator
from adr_service.effects.models import amounts


def held_out_without(fit: Fit, gone: Sequence[int]) -> Vector:
    """(E,) nats: `held_out_where` with the fit's own persistence, without effects of these numbers,
    as far as all is linear.

    Compare with the same without none: both start from the likelier of two noises.
    """
    lost, linear = [fit.columns_of(slice(n, n + 1)) for n in gone], fit.linear
    columns = [column for slot in lost for column in range(slot.start, slot.stop)]
    values = np.concatenate([*(amounts(fit.effects[n]) for n in gone), np.empty(0)])
    kept = np.setdiff1d(np.arange(linear.columns.shape[3]), columns)
    linear = Linear(
        linear.chain,
        linear.residual + linear.columns[..., columns] @ values,
        linear.columns[..., kept],
        linear.mean[kept],
        linear.precision[kept],
    )
    share, start = fit.persistence.share, likelier_noise(fit, linear)
    if share == 0:
        return estimate(linear, start, fit.stated)[1].left_out()
    starts = [fit.persistence.noise, start]
    return persisting(linear, share, starts, fit.stated)[1].left_out()


def gained(fit: Fit, without: Fit) -> Vector:
    """(E,) nats by which a fit predicts better than one without some of its effects.

    Where the fit's misfit persists, beside that: otherwise forces that are correlated in time, and
    a controller's answer to them, look like an effect.
    """
    return held_out_where(fit.persistence, fit) - held_out_where(fit.persistence, without)


def held_out_where(persistence: Persistence, fit: Fit) -> Vector:
    """(E,) nats: `Fit.held_out`, where misfit persists as it does in a better fit."""
    if persistence.share == 0:
        return fit.held_out
    starts = [persistence.noise, fit.noise]
    return persisting(fit.linear, persistence.share, starts, fit.stated)[1].left_out()


def residuals_of(fit: Fit, simulator: Simulator) -> tuple[Chain, Array3]:
    """Residuals (E, T, m) of a fit on other data, around the states as they were measured."""
    layout, states = Layout.of(simulator), simulator.measured
    known = (fit.parameters, fit.effects, states)
    linear, _ = linearise(simulator, layout, *known, exact_root(simulator))
    change = fit.normal.change()[0][fit.integration]
    return linear.chain, linear.residual - linear.columns[..., fit.integration] @ change


def expected_errors(fit: Fit) -> Vector:
    """Typical deviation (m,) of a one-step error by a fit; NaN for columns that nobody measured.

    Predictions start from readings, and from inferred states where there is no reading.
    """
    chain, noise, measured = fit.linear.chain, fit.noise, fit.simulator.data.is_measured()
    start = noise.sensor
    if not measured.all():
        _, covariance = Whitener.of(chain, noise).sensor_errors(fit.left)
        inferred = np.diagonal(fit.layout.by_row(fit.simulator, covariance), axis1=1, axis2=2)
        start = np.where(measured, start, np.median(inferred, axis=0))
    variance = (chain.transition[chain.mask] ** 2) @ start + noise.sensor
    variance = np.median(variance + misfit_variance(chain, noise)[chain.mask], axis=0)
    return np.where(measured, np.sqrt(variance), np.nan)
