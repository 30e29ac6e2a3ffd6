"""Evidence for effects: how much better the data are predicted with them than without.

    baseline = fit(simulator, sensor)  # free parameters and noise
    candidates = scan(baseline, Responses(baseline))     # every (kind, location), linearised
    refined = refine(baseline, candidates[0].effects)  # nonlinear, with its own noise

All fits are Gauss-Newton steps on whitened one-step residuals around states: the measured ones, or
the most probable ones (`probable_states.smoothed`), as everywhere in the search. A gain is the
log-likelihood, in nats, of episodes that were left out one at a time from the fit, with the effect
minus without. What the free parameters can explain is not evidence: they are fitted in both. Nor is
what a smaller simulator step would change, which is fitted as if it were a parameter.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from adr_service.arrays import Array3, Mask, Matrix, Vector
from adr_service.criticism.bounded_steps import shorter
from adr_service.criticism.layout import Layout
from adr_service.criticism.linear import (
    Linear,
    Normal,
    Persistence,
    estimate,
    likelihood,
    persistence_of,
    persisting,
)
from adr_service.criticism.linearisation import (
    INTEGRATION,
    by_strengths,
    linearise,
    tiny_root,
    with_priors,
)
from adr_service.criticism.noise import (
    Chain,
    Noise,
    Whitener,
    at_start,
    lifted,
    misfit_variance,
)
from adr_service.criticism.simulator import Simulator
from adr_service.criticism.within_bounds import (
    bounds_of_steps,
    estimate_within_bounds,
    values_of,
)
from adr_service.effects.base import Effect
from adr_service.effects.models import amounts, plausible_of, typical_of

_STEPS, _REFUSED = 15, 3  # at most; and so many that were refused, one after the other
_CONVERGED = 0.3  # [nats] that a step gains at least
NEAR = 0.25  # of a value, or of a typical strength: so far, derivatives by it hardly change


@dataclass(frozen=True)
class Fit:
    """A simulator with fitted parameters and effects, and what it leaves unexplained.

    The columns of `linear` and `normal` are the parameters, integration, the effects' strengths.
    """

    simulator: Simulator
    sensor: Vector  # (m,) stated variances of the sensors' noise, NaN where it is not known
    layout: Layout
    parameters: Vector  # (d,) SI
    effects: tuple[Effect, ...]
    states: Matrix  # (rows, m) smoothed, around which everything is linear
    predicted: Matrix  # (N, m) by the simulator from there, with these parameters and effects
    linear: Linear
    noise: Noise
    normal: Normal
    known: int = 0  # of the effects, the first ones, that are there for sure, however strong

    @property
    def settled(self) -> "Fit":
        """The fit with its own effects, its strengths and noise settled around its states."""
        return self if "_is_settled" in vars(self) else self._settled

    @cached_property
    def _settled(self) -> "Fit":
        found = refine(self, self.effects) or self
        vars(found)["_is_settled"] = True  # which no fit with other values inherits
        return found

    @property
    def simulated(self) -> int:
        """Number of transitions that it simulates to their end."""
        return int(self.linear.chain.mask.sum())

    @property
    def stated(self) -> Mask:
        """(m,) true for sensors whose noise is known."""
        return ~np.isnan(self.sensor)

    @property
    def held_out(self) -> Vector:
        """(E,) nats: log-likelihood of each episode by a fit to the others."""
        return self.normal.left_out()

    @cached_property
    def persistence(self) -> Persistence:
        """The share of its misfit that a transition passes on to the next one."""
        return persistence_of(self.linear, self.noise, self.stated)

    @property
    def left(self) -> Array3:
        """(E, T, m) residuals that the fitted columns leave."""
        return self.linear.residual - self.linear.columns @ self.normal.change()[0]

    @property
    def integration(self) -> slice:
        """Columns of what numerical integration adds."""
        return slice(len(self.parameters), len(self.parameters) + INTEGRATION)

    def columns_of(self, slot: slice) -> slice:
        """Columns of the strengths of some of the effects."""
        before, own = self.effects[: slot.start], self.effects[slot]
        first = self.integration.stop + sum(len(e.values) for e in before)
        return slice(first, first + sum(len(e.values) for e in own))

    def columns_at(self, effect: Effect) -> slice | None:
        """Columns of the supposed effect of this kind and place, if the fit has it already."""
        for number, own in enumerate(self.effects[self.known :], self.known):
            if (own.kind, own.location) == (effect.kind, effect.location):
                return self.columns_of(slice(number, number + 1))
        return None


def fit(simulator: Simulator, sensor: Vector, effects: Sequence[Effect] = ()) -> Fit:
    """The simulator at its best with these effects, around the states as they were measured.

    The effects are known to be there; others that later fits add are supposed to be about as strong
    as `Mechanism.likely` says.
    `sensor` (m,): stated variances of the sensors' noise, NaN where it is not known.
    """
    layout, states, start = Layout.of(simulator), simulator.measured, simulator.nominal.start
    own = tuple(effects)
    linear, predicted = linearise(simulator, layout, start, own, states, _exact(simulator))
    noise = _first_noise(linear, sensor)
    known = ~np.isnan(sensor)
    noise, normal = estimate(linear, lifted(noise, linear.chain, linear.residual, known), known)
    at = (start, own, states, predicted)
    return Fit(simulator, sensor, layout, *at, linear, noise, normal, known=len(own)).settled


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
    share, start = fit.persistence.share, _likelier(fit, linear)
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
    linear, _ = linearise(simulator, layout, *known, _exact(simulator))
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


def refine(fit: Fit, effects: Sequence[Effect]) -> Fit | None:
    """The fit with these effects, from strengths near the best ones; its states stay.

    None: with these effects the simulation diverges where it did not before, and they explain
    nothing. Compare with `fit.settled`.
    """
    first = tried(fit, effects)
    return None if first is None else improved(fit, first)


def tried(fit: Fit, effects: Sequence[Effect]) -> Fit | None:
    """`refine` without its steps: at the strengths as they are, and linear about them."""
    return _evaluated(fit, fit.parameters, tuple(effects), None)


def improved(fit: Fit, first: Fit) -> Fit:
    """A fit that was `tried`, after steps to better strengths.

    Steps end at bounds, and one that makes the data less probable is shortened. The derivatives by
    parameters, and by effects that the fit has already, stay as well, those by new strengths while
    these stay near.
    """
    best, about, step = first, first.effects, first.normal.change()[0]
    refused, columns = 0, fit.integration
    for _ in range(_STEPS):
        at = best.parameters, best.effects
        bounds, values = bounds_of_steps(fit.simulator, *at), values_of(*at)
        within = bounds.limited(values, step)
        after = bounds.moved(values, within)
        parameters = after[: columns.start]
        effects = _with_strengths(best.effects, after[columns.stop :])
        known = best if are_near(fit.simulator, about, effects) else None
        other = _evaluated(fit, parameters, effects, best.noise, known)
        more = -np.inf if other is None else _likelier_by(other, best)
        if other is None or not more > 0:
            refused += 1
            if refused == _REFUSED:
                break
            step = shorter(step, within)
            continue
        was_whole = refused == 0
        best, step, refused = other, other.normal.change()[0], 0
        about = about if known else effects
        if was_whole and more < _CONVERGED:
            break
    return best


def _likelier_by(other: Fit, best: Fit) -> float:
    """[nats] by which the data are likelier with one fit's values than with another's, on average
    under the noise of either.

    Each noise flatters its own fit: it knows which transitions that one leaves. And where it is
    small, what is still to go looks large.
    """
    columns = best.integration
    under_its_own = other.normal.best_log_likelihood(columns)
    under_its_own -= likelihood(best.linear, other.noise, columns)
    under_the_others = likelihood(other.linear, best.noise, columns)
    under_the_others -= best.normal.best_log_likelihood(columns)
    more = (under_its_own + under_the_others) / 2
    return more if np.isfinite(more) else -np.inf  # a noise that cannot be computed tells nothing


def _evaluated(
    fit: Fit,
    parameters: Vector,
    effects: tuple[Effect, ...],
    noise: Noise | None,
    near: Fit | None = None,
) -> Fit | None:
    """Another fit's states and sensitivities, with other parameters and effects.

    `noise` to start from, None: the likelier of the other fit's and of a guess; `near`, a fit with
    the same effects whose sensitivities will do. None: some transition diverges, or the noise does.
    """
    predicted = fit.simulator.predict(parameters, effects, fit.states)
    moved = _folded(fit, predicted - fit.predicted)
    if not np.all(np.isfinite(moved)):
        return None
    columns = near.linear.columns if near else _sensitivities(fit, parameters, effects, predicted)
    if not np.all(np.isfinite(columns)):
        return None
    chain, residual = fit.linear.chain, fit.linear.residual - moved
    linear = with_priors(chain, residual, columns, len(parameters))
    linear = with_effect_priors(fit, linear, effects)
    try:
        start = _likelier(fit, linear) if noise is None else noise
        known = (parameters, effects, linear, start, fit.stated)
        linear, noise, normal = estimate_within_bounds(fit.simulator, *known)
    except np.linalg.LinAlgError:  # what it leaves has no finite variance beside exact readings
        return None
    return replace(
        fit,
        parameters=parameters,
        effects=effects,
        predicted=predicted,
        linear=linear,
        noise=noise,
        normal=normal,
    )


def _sensitivities(
    fit: Fit, parameters: Vector, effects: Sequence[Effect], predicted: Matrix
) -> np.ndarray:
    """Columns (E, T, m, p) of a fit's parameters and of effects, those that it has among them, with
    which the simulator has `predicted` (N, m)."""
    places = [fit.columns_at(effect) for effect in effects]
    new = [effect for effect, where in zip(effects, places, strict=True) if where is None]
    derivatives: Iterator[Matrix] = iter(())
    if new:
        known = (parameters, tuple(effects), fit.states)
        quickly = fit.simulator.quickly(predicted, *known)
        derivatives = iter(by_strengths(fit.simulator, *known, new, quickly))
    columns = [fit.linear.columns[..., : fit.integration.stop]]
    for effect, where in zip(effects, places, strict=True):
        if where is not None:
            columns.append(fit.linear.columns[..., where])
        else:
            own = [next(derivatives) for _ in effect.values]
            columns.append(_folded(fit, np.stack(own, axis=2)))
    return np.concatenate(columns, axis=3)


def _folded(fit: Fit, changes: np.ndarray) -> np.ndarray:
    """Changes (N, …) of predictions by episode, zero where the fit has no transition."""
    folded = fit.layout.fold(changes)
    folded[~fit.linear.chain.mask] = 0.0
    return folded


def are_near(simulator: Simulator, before: Sequence[Effect], after: Sequence[Effect]) -> bool:
    """True if all strengths are within a quarter of what they were, or of a typical one."""
    for one, other in zip(before, after, strict=True):
        typical = typical_of(simulator.base, one.kind, one.location)
        reach = NEAR * np.maximum(np.abs(one.values), typical)
        if np.any(np.abs(np.subtract(other.values, one.values)) > reach):
            return False
    return True


def with_effect_priors(fit: Fit, linear: Linear, effects: Sequence[Effect]) -> Linear:
    """The linear model with the priors of all effects that are not known to be there."""
    added = effects[fit.known :]
    if not added:
        return linear
    values = np.concatenate([effect.values for effect in added])
    likely = np.concatenate([plausible_of(fit.simulator.base, effect) for effect in added])
    mean, precision = linear.mean.copy(), linear.precision.copy()
    mean[-len(values) :], precision[-len(values) :] = -values, 1 / likely**2
    return replace(linear, mean=mean, precision=precision)


def _exact(simulator: Simulator) -> np.ndarray:
    """Roots (rows, m, m) for states that are not known to be uncertain."""
    rows, m = simulator.measured.shape
    return np.broadcast_to(tiny_root(simulator), (rows, m, m))


def _likelier(fit: Fit, linear: Linear) -> Noise:
    """Noise to start from: a fit's own, or a guess where other effects leave much more."""
    own = lifted(fit.noise, fit.linear.chain, fit.left, fit.stated)
    guess = _first_noise(linear, fit.sensor)
    guess = lifted(guess, linear.chain, linear.residual, fit.stated)
    return max((own, guess), key=lambda noise: likelihood(linear, noise))


def _first_noise(linear: Linear, sensor: Vector) -> Noise:
    """A guess, from what the columns leave."""
    mask, p = linear.chain.mask, linear.columns.shape[3]
    rows = linear.columns[mask].reshape(-1, p)
    change = np.linalg.lstsq(rows, linear.residual[mask].ravel(), rcond=None)[0]
    return at_start(linear.chain, linear.residual - linear.columns @ change, sensor)


def _with_strengths(effects: tuple[Effect, ...], values: Vector) -> tuple[Effect, ...]:
    """Effects with other strengths, in one row."""
    left: Iterator[float] = iter(values.tolist())
    return tuple(replace(e, values=tuple(next(left) for _ in e.values)) for e in effects)
