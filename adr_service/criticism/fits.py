"""Fits: a simulator at its best with some effects, about some states.

    baseline = fit(simulator, sensor)               # about the states as they were measured
    refined = refine(baseline, [effect])            # about states that are probable with the effect

A fit is Gauss-Newton steps on whitened one-step residuals around states: the measured ones, or the
most probable ones (`probable_states.smoothed`).
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
)
from adr_service.criticism.linearisation import (
    INTEGRATION,
    by_strengths,
    linearise,
    passed_on,
    tiny_root,
    with_priors,
)
from adr_service.criticism.noise import Noise, Whitener
from adr_service.criticism.simulator import Simulator
from adr_service.criticism.variances import at_start, lifted
from adr_service.criticism.within_bounds import (
    bounds_of_steps,
    estimate_within_bounds,
    values_of,
)
from adr_service.effects.base import Effect
from adr_service.effects.models import plausible_of, typical_of

_RESTATED, _LITTLE = 3, 10.0  # changes of states at most; one that gains fewer nats is the last
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
    states: Matrix  # (rows, m) as sensors show them, around which everything is linear
    predicted: Matrix  # (N, m) by the simulator from there, with these parameters and effects
    linear: Linear
    noise: Noise
    normal: Normal
    known: int = 0  # of the effects, the first ones, that are there for sure, however strong

    @property
    def settled(self) -> "Fit":
        """The fit with its own effects, its strengths, states and noise settled."""
        return self if "_is_settled" in vars(self) else self._settled

    @cached_property
    def _settled(self) -> "Fit":
        return refine(self, self.effects) or self

    @cached_property
    def true_states(self) -> Matrix:
        """(rows, m) the robot's states, behind what its sensors show."""
        return self.simulator.true_states(self.parameters, self.effects, self.states)

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
        """Columns of the supposed effect of this kind and place, if the fit has it already.

        None if its strengths are far from those of the fit, or if the fit has it without some of
        them, which have no column then.
        """
        for number, own in enumerate(self.effects[self.known :], self.known):
            if (own.kind, own.location) == (effect.kind, effect.location):
                is_more = np.any(np.equal(own.values, 0.0) & np.not_equal(effect.values, 0.0))
                if is_more or not are_near(self.simulator, [own], [effect]):
                    return None
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
    linear, predicted = linearise(simulator, layout, start, own, states, exact_root(simulator))
    noise = _first_noise(linear, sensor)
    known = ~np.isnan(sensor)
    noise, normal = estimate(linear, lifted(noise, linear.chain, linear.residual, known), known)
    at = (start, own, states, predicted)
    found = Fit(simulator, sensor, layout, *at, linear, noise, normal, known=len(own))
    return settled_there(found)


def refine(fit: Fit, effects: Sequence[Effect]) -> Fit | None:
    """The fit with these effects, from strengths near the best ones, about states that are probable
    with them.

    None: with these effects the simulation diverges where it did not before, and they explain
    nothing. Compare with `fit.settled`.
    """
    first = tried(fit, effects)
    return None if first is None else improved(fit, first)


def settled_there(fit: Fit) -> Fit:
    """The fit with its strengths and noise settled around the states that it has."""
    first = tried(fit, fit.effects)
    return fit if first is None else _stepped(fit, first)


def tried(fit: Fit, effects: Sequence[Effect]) -> Fit | None:
    """`refine` without its steps: at the strengths as they are, and linear about them."""
    return _evaluated(fit, fit.parameters, tuple(effects), None)


def improved(fit: Fit, first: Fit) -> Fit:
    """A fit that was `tried`, after steps to better strengths, and about states that are more
    probable with them, by the derivatives that it has.

    Otherwise a new effect would be judged about states that were found without it. This takes a
    small part of the simulations of `probable_states.smoothed`.
    """
    best = _stepped(fit, first)
    for _ in range(_RESTATED):
        moved = _restated(best)
        if moved is None:
            break
        moved, _ = likelier_of(best, moved)
        more = float(moved.held_out.sum() - best.held_out.sum())
        if more > 0:
            best = _stepped(moved, moved) if _still_gained(moved) > _CONVERGED else moved
        if more < _LITTLE:
            break
    vars(best)["_is_settled"] = True  # which no fit with other values inherits
    return best


def _restated(fit: Fit) -> Fit | None:
    """A fit about its most probable states, but for episodes that diverge from there."""
    states = most_probable(fit)[0]
    predicted = fit.simulator.predict(fit.parameters, fit.effects, states)
    is_lost = ~np.all(np.isfinite(_folded(fit, predicted)), axis=(1, 2))
    rows = repeated_by_row(fit, is_lost)[:, None]
    states = np.where(rows, fit.states, states)
    predicted = np.where(rows[fit.simulator.starts], fit.predicted, predicted)
    known = (fit.parameters, fit.effects, states, predicted)
    return _about(fit, *known, noise=fit.noise, near=fit)


def _stepped(fit: Fit, first: Fit) -> Fit:
    """A fit that was `tried`, after steps to better strengths, about the states that it has.

    Steps end at bounds, and one that makes the data less probable is shortened. The derivatives by
    parameters stay as well, and those by strengths while these stay near.
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


def most_probable(fit: Fit) -> tuple[Matrix, np.ndarray]:
    """The most probable states (rows, m) under a fit, and their covariances (rows, m, m)."""
    whitener = Whitener.of(fit.linear.chain, fit.noise)
    errors, covariance = (
        fit.layout.by_row(fit.simulator, each) for each in whitener.sensor_errors(fit.left)
    )
    return fit.simulator.measured - errors, covariance


def _still_gained(fit: Fit) -> float:
    """[nats] that a whole step to better values gains, as far as all is linear."""
    return fit.normal.best_log_likelihood() - fit.normal.best_log_likelihood(fit.integration)


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
    """Another fit with other parameters and effects, about the robot's states that it has.

    Other effects in sensors move their readings. If these stayed, the robot would have to move, and
    where it stands on the ground it would be pushed into it.
    """
    paths = fit.simulator.paths(parameters, effects, fit.true_states)
    states, predicted = fit.simulator.sensors.shown(effects, paths)
    return _about(fit, parameters, effects, states, predicted, noise=noise, near=near)


def _about(
    fit: Fit,
    parameters: Vector,
    effects: tuple[Effect, ...],
    states: Matrix,
    predicted: Matrix,
    *,
    noise: Noise | None,
    near: Fit | None,
) -> Fit | None:
    """Another fit with other parameters and effects, about other states (rows, m), from which the
    simulator has `predicted` (N, m).

    It keeps the fit's derivatives, and those of `near`, a fit with almost the same effects. The
    noise is found from `noise` on, by default the likelier of the fit's and of a guess. Returns
    None if some transition diverges, or the noise does.
    """
    transition = fit.linear.chain.transition[fit.layout.mask]
    shifted = passed_on(transition, (states - fit.states)[fit.simulator.starts])
    moved = _folded(fit, predicted - fit.predicted - shifted)
    if not np.all(np.isfinite(moved)):
        return None
    at = (parameters, effects, states, predicted, transition)
    columns = near.linear.columns if near else _sensitivities(fit, *at)
    if not np.all(np.isfinite(columns)):
        return None
    chain, residual = fit.linear.chain, fit.linear.residual - moved
    linear = with_priors(chain, residual, columns, len(parameters))
    linear = with_effect_priors(fit, linear, effects)
    try:
        start = likelier_noise(fit, linear) if noise is None else noise
        known = (parameters, effects, linear, start, fit.stated)
        linear, noise, normal = estimate_within_bounds(fit.simulator, *known)
    except np.linalg.LinAlgError:  # what it leaves has no finite variance beside exact readings
        return None
    return replace(
        fit,
        parameters=parameters,
        effects=effects,
        states=states,
        predicted=predicted,
        linear=linear,
        noise=noise,
        normal=normal,
    )


def _sensitivities(
    fit: Fit,
    parameters: Vector,
    effects: tuple[Effect, ...],
    states: Matrix,
    predicted: Matrix,
    transition: np.ndarray,
) -> np.ndarray:
    """Columns (E, T, m, p) of a fit's parameters and of effects, those that it has among them, with
    which the simulator has `predicted` (N, m); `transition` as for `by_strengths`."""
    places = [fit.columns_at(effect) for effect in effects]
    new = [effect for effect, where in zip(effects, places, strict=True) if where is None]
    derivatives: Iterator[Matrix] = iter(())
    if new:
        known = (parameters, effects, states)
        quickly = fit.simulator.quickly(predicted, *known)
        derivatives = iter(by_strengths(fit.simulator, *known, new, quickly, transition))
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


def exact_root(simulator: Simulator) -> np.ndarray:
    """Roots (rows, m, m) for states that are not known to be uncertain."""
    rows, m = simulator.measured.shape
    return np.broadcast_to(tiny_root(simulator), (rows, m, m))


def likelier_noise(fit: Fit, linear: Linear) -> Noise:
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


def likelier_of(fit: Fit, other: Fit) -> tuple[Fit, Mask]:
    """Each episode as one of two fits has it that differ in their states alone, whichever simulates
    more of it or makes it likelier, and (E,) true where that is the other."""
    counts, more = (each.linear.chain.mask.sum(axis=1) for each in (fit, other))
    is_likelier = (more > counts) | ((more == counts) & (other.held_out > fit.held_out))
    if is_likelier.all():
        return other, is_likelier

    def chosen(new: np.ndarray, old: np.ndarray, which: Mask = is_likelier) -> np.ndarray:
        return np.where(which.reshape(-1, *[1] * (new.ndim - 1)), new, old)

    new, old, rows = other.linear, fit.linear, repeated_by_row(fit, is_likelier)
    chain = replace(
        new.chain,
        mask=chosen(new.chain.mask, old.chain.mask),
        transition=chosen(new.chain.transition, old.chain.transition),
        stiff=chosen(new.chain.stiff, old.chain.stiff),
    )
    linear = replace(
        new,
        chain=chain,
        residual=chosen(new.residual, old.residual),
        columns=chosen(new.columns, old.columns),
    )
    noise = replace(other.noise, weights=chosen(other.noise.weights, fit.noise.weights))
    mixed = replace(
        fit,
        states=chosen(other.states, fit.states, rows),
        predicted=chosen(other.predicted, fit.predicted, rows[fit.simulator.starts]),
        linear=linear,
        noise=lifted(noise, chain, linear.residual, fit.stated),
    )
    return noise_anew(mixed), is_likelier


def noise_anew(fit: Fit) -> Fit:
    """A fit with its noise estimated anew, where no parameter leaves its bounds."""
    known = (fit.parameters, fit.effects, fit.linear, fit.noise, fit.stated)
    linear, noise, normal = estimate_within_bounds(fit.simulator, *known)
    return replace(fit, linear=linear, noise=noise, normal=normal)


def repeated_by_row(fit: Fit, values: np.ndarray) -> np.ndarray:
    """Values (E,) of episodes for each row (rows,)."""
    return np.concatenate(
        [np.repeat(v, b - a) for v, (a, b) in zip(values, fit.simulator.data.spans(), strict=True)]
    )
