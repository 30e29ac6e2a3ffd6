"""Least-squares fits of a simulator with given effects, by MuJoCo's system identification toolbox.

    with simulator_of(nominal, data) as simulator:
        fits = Fits(simulator, whole_episodes)
        fitted = fits.fit([effect], fits.plain.parameters)
        fitted.bic() - fits.plain.bic()

Errors are of one step, or of whole episodes.
"""

from collections.abc import Callable, Iterator, Sequence
from contextlib import redirect_stdout
from dataclasses import dataclass, replace
from io import StringIO
from typing import Any

import mujoco
import numpy as np
from mujoco import sysid

from adr_service.arrays import Array3, Matrix, Vector
from adr_service.criticism.extension import written_out
from adr_service.criticism.measurements import Measurement
from adr_service.criticism.nominal import Nominal
from adr_service.criticism.simulator import Simulator
from adr_service.effects.base import Effect
from adr_service.effects.catalogue import get_mechanism
from adr_service.effects.models import shapes_of, typical_of
from adr_service.errors import InvalidInput

_WIDE = 100.0  # bound of a strength, in multiples of its typical size
_ITERATIONS, _CLOSE = 15, 1e-3  # of a search, and the step at which it ends, in the scales
_MOVED = 1e-4  # [SI] of a first state, to linearise
_NEARBY = 1e-3  # relative, of a parameter
_SMALL = 0.1  # times typical, of an effect in proportion to its strength, to linearise

# measured minus predicted states (n, m) of a simulator with these parameters and effects
Errors = Callable[[Vector, Sequence[Effect]], Matrix]
# errors of a simulator, linearised where necessary at parameters, with sensors' deviations (m,)
ErrorsOf = Callable[[Simulator, Vector, Vector], Errors]


def simulator_of(nominal: Nominal, data: Measurement) -> Simulator:
    """A simulator without errors of integration, which would pass for inertia and friction.

    MuJoCo's implicit integrators add some of both at coarse steps; Runge and Kutta's does not. Our
    method has to find that out by itself.
    """
    spec = mujoco.MjSpec.from_string(nominal.xml)
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_RK4
    return Simulator(replace(nominal, xml=written_out(spec)), data, threads=1)


def one_step(simulator: Simulator, parameters: Vector, deviations: Vector) -> Errors:
    """Errors of predictions one control step ahead of every row."""
    ahead = simulator.measured[simulator.starts + 1]
    return lambda values, effects: ahead - simulator.predict(values, effects, simulator.measured)


def whole_episodes(simulator: Simulator, parameters: Vector, deviations: Vector) -> Errors:
    """Errors of whole episodes, simulated from their first rows on.

    First readings are noisy. So whatever other first states would change, linearised about the
    simulator with these parameters, is projected out of every episode's errors.
    """
    explained = list(_by_first_states(simulator, parameters, deviations))

    def errors(values: Vector, effects: Sequence[Effect]) -> Matrix:
        away = simulator.measured - simulator.follow(values, effects)
        left = away[simulator.starts + 1] / deviations
        for rows, basis in explained:
            flat = left[rows].ravel()
            left[rows] = (flat - basis @ (basis.T @ flat)).reshape(-1, len(deviations))
        return left * deviations

    return errors


def _by_first_states(
    simulator: Simulator, parameters: Vector, deviations: Vector
) -> Iterator[tuple[slice, Matrix]]:
    """For each episode its transitions, and an orthonormal basis (their errors, m) of what other
    first states change."""
    data = simulator.data
    firsts = [first for first, _ in data.spans()]
    plain = simulator.follow(parameters, ())
    changes: list[Matrix] = []
    for column in range(plain.shape[1]):
        moved = np.concatenate([data.qpos, data.qvel], axis=1)
        moved[firsts, column] += _MOVED
        nq = data.qpos.shape[1]
        other = replace(data, qpos=moved[:, :nq], qvel=moved[:, nq:])
        with Simulator(simulator.nominal, other, threads=1) as nearby:
            changed = nearby.follow(parameters, ()) - plain
            changes.append(changed[simulator.starts + 1] / deviations)
    for begin, end in simulator.transitions():
        columns = np.stack([change[begin:end].ravel() for change in changes], axis=1)
        yield slice(begin, end), np.linalg.qr(columns)[0]


def by_parameters(errors: Errors, values: Vector) -> Array3:
    """Changes (n, m, d) of the errors by each free parameter, in relative terms."""
    plain = errors(values, ())
    nearby = [errors(values * factor, ()) for factor in 1 + _NEARBY * np.eye(len(values))]
    return np.stack([(each - plain) / _NEARBY for each in nearby], axis=2)


def without(explained: Matrix, values: Matrix) -> Matrix:
    """Residual of values (n, …) after least squares on the columns (n, d)."""
    sizes = np.linalg.norm(explained, axis=0)
    basis, _ = np.linalg.qr(explained[:, sizes > 0] / sizes[sizes > 0])
    return values - basis @ (basis.T @ values)


@dataclass(frozen=True)
class Fitted:
    """A simulator at its best fit."""

    parameters: Vector
    effects: tuple[Effect, ...]
    errors: Matrix  # (n, m) [SI]
    jacobian: Matrix  # (n m, k) of errors in deviations, by parameters and strengths, scaled
    reach: Vector  # half widths of the 95 % intervals of all strengths

    def bic(self) -> float:
        """Bayesian information criterion, each sensor's noise at its maximum-likelihood value."""
        n, m = self.errors.shape
        spread = float(np.sum(n * np.log(np.mean(self.errors**2, axis=0))))
        return spread + (self.jacobian.shape[1] + m) * float(np.log(n * m))


@dataclass(frozen=True)
class Step:
    """The first step towards an effect, and the fall of the squared errors that it promises."""

    effect: Effect
    fall: float  # in squares of deviations


class Fits:
    """Fits of one question's simulator, with any effects."""

    def __init__(self, simulator: Simulator, errors_of: ErrorsOf):
        self._nominal, self._base = simulator.nominal, simulator.base
        start, width = simulator.nominal.start, simulator.measured.shape[1]
        self._deviations = np.ones(width)
        self._errors = errors_of(simulator, start, self._deviations)
        rough = self._plain(start)
        self._deviations = np.sqrt(np.mean(rough.errors**2, axis=0))
        self._errors = errors_of(simulator, rough.parameters, self._deviations)
        self.plain = self._plain(rough.parameters)  # with the weights that the first asks for

    def _plain(self, start: Vector) -> Fitted:
        """The fit without effects; raises InvalidInput if the simulation diverges."""
        if (fitted := self.fit((), start)) is None:
            raise InvalidInput("the simulation diverges from the measured states")
        return fitted

    def fit(self, effects: Sequence[Effect], start: Vector) -> Fitted | None:
        """The best parameters and strengths from these on; None if the simulation diverges."""
        given = sysid.ParameterDict()
        given.add(self._parameters(start))
        for number, effect in enumerate(effects):
            given.add(self._strengths(str(number), effect))
        with redirect_stdout(StringIO()):  # it prints a line for every iteration
            try:
                best, found = sysid.optimize(
                    given,
                    lambda x, _: ([self._of_columns(x, effects)], None, None),
                    max_iters=_ITERATIONS,
                    xtol=_CLOSE,
                    verbose=False,
                )
            except _Diverged:
                return None
        values, named = self._split(best.as_vector(), effects)
        errors, jacobian = self._errors(values, named), np.asarray(found.jac)
        _, reach = sysid.calculate_intervals([(errors / self._deviations).ravel()], jacobian)
        scales = np.concatenate([*(self._typical(effect) for effect in effects), np.empty(0)])
        return Fitted(values, tuple(named), errors, jacobian, reach[len(values) :] * scales)

    def step(self, known: Fitted, effect: Effect) -> Step:
        """The Gauss-Newton step that adds an effect and moves everything else.

        An effect that is not in proportion to its strength is tried at all its sizes. One with a
        shape is not tried: without its number of waves it is a constant.
        """
        if shapes_of(effect.kind).any():
            return Step(effect, -np.inf)
        sizes = get_mechanism(effect.kind).sizes
        tried = [self._step(known, effect, s) for s in (sizes if len(sizes) > 1 else (_SMALL,))]
        return max(tried, key=lambda step: step.fall)

    def _step(self, known: Fitted, effect: Effect, size: float) -> Step:
        before = known.errors / self._deviations
        typical = size * self._typical(effect)
        columns: list[Vector] = []
        for number in range(len(typical)):
            added = _with(effect, np.where(np.arange(len(typical)) == number, typical, 0.0))
            errors = self._errors(known.parameters, [*known.effects, added])
            columns.append((errors / self._deviations - before).ravel())
        design = np.column_stack([known.jacobian, *columns])
        low = np.array([s.low for s in get_mechanism(effect.kind).strengths])
        if not np.all(np.isfinite(design)):
            return Step(_with(effect, typical), -np.inf)  # the simulation diverged
        solved = np.linalg.lstsq(design, -before.ravel(), rcond=None)[0]
        strengths = solved[known.jacobian.shape[1] :] * typical
        has_sides = get_mechanism(effect.kind).has_sides
        if np.any(strengths < low) or (has_sides and np.any(strengths * size < 0)):
            return Step(_with(effect, typical), 0.0)  # least squares would leave the bounds
        after = before.ravel() + design @ solved
        return Step(_with(effect, strengths), float(np.sum(before**2) - np.sum(after**2)))

    def _of_columns(self, x: Matrix, effects: Sequence[Effect]) -> Matrix:
        """Errors in deviations: (n m,) of a vector, (n m, p) of a matrix with p columns."""
        points = x.reshape(len(x), -1).T
        errors = [self._errors(*self._split(point, effects)) for point in points]
        flat = np.stack([(each / self._deviations).ravel() for each in errors], axis=1)
        if not np.all(np.isfinite(flat)):
            raise _Diverged
        return flat[:, 0] if x.ndim == 1 else flat

    def _split(self, x: Vector, effects: Sequence[Effect]) -> tuple[Vector, list[Effect]]:
        """Parameters and effects of a vector that has both in their scales."""
        d, named = len(self._nominal.start), list[Effect]()
        rest = x[d:]
        for effect in effects:
            named.append(_with(effect, rest[: len(effect.values)] * self._typical(effect)))
            rest = rest[len(effect.values) :]
        return x[:d] * np.abs(self._nominal.start), named

    def _typical(self, effect: Effect) -> Vector:
        return typical_of(self._base, effect.kind, effect.location)

    def _parameters(self, start: Vector) -> Any:
        space, scale = self._nominal.space, np.abs(self._nominal.start)
        low = np.array([p.feasible_low for p in space.parameters])
        high = np.array([p.high for p in space.parameters])
        return sysid.Parameter("parameters", start / scale, low / scale, high / scale)

    def _strengths(self, name: str, effect: Effect) -> Any:
        strengths, typical = get_mechanism(effect.kind).strengths, self._typical(effect)
        low = np.maximum(np.array([s.low for s in strengths]) / typical, -_WIDE)
        start = np.clip(np.array(effect.values) / typical, low, _WIDE)
        return sysid.Parameter(name, start, low, np.full(len(low), _WIDE))


class _Diverged(Exception):
    """A simulation that a fit tried is not finite."""


def _with(effect: Effect, strengths: Vector) -> Effect:
    return replace(effect, values=tuple(strengths.tolist()))
