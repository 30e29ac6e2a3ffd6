"""Every possible cause, linearised: which the data ask for, and how large it would be.

    found = scan(baseline, Effects(baseline))       # the best first
    found[0].causes, found[0].gain

A cause is tried beside the free parameters and the causes of a fit: what they can absorb is no
evidence. A group is one kind of effect at all its places at once, each with a strength of its own.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from adr_service.arrays import Matrix, Vector
from adr_service.causes import Cause
from adr_service.criticism.evidence import Fit
from adr_service.criticism.linear import products
from adr_service.criticism.noise import Whitener
from adr_service.criticism.simulator import Simulator
from adr_service.simulation.mechanism import sensors
from adr_service.simulation.mechanisms import MECHANISMS, element_of, get_mechanism

_ABSORBED = 1e2  # how much less the data may say of a strength once parameters are fitted as well
_UNSEEN = 1e8  # variance of a strength, in typical ones, that no sensible robot has


@dataclass(frozen=True)
class Candidate:
    """One possible cause, or a group of one kind, at the strengths that the data ask for."""

    tried: tuple[Cause, ...]  # at the sizes that its effects were taken from
    causes: tuple[Cause, ...]
    gains: Vector  # (E,) nats by episode, each left out of the fit
    deviations: Vector  # of the strengths, were the cause there alone; inf: data say nothing

    @property
    def gain(self) -> float:
        return float(self.gains.sum())

    @property
    def kind(self) -> str:
        return self.causes[0].kind

    @property
    def location(self) -> str:
        return location_of(self.causes)


def scan(fit: Fit, effects: "Effects") -> list[Candidate]:
    """Every (kind, location) at the strengths the data ask for, and every group; the best first."""
    look = _Scan(fit, effects)
    named = {(cause.kind, cause.location) for cause in fit.causes}
    asked = [place for place in places(fit.simulator) if place not in named]
    found = [look.alone(*place) for place in asked]
    groups: dict[str, list[Candidate]] = {}
    for candidate in found:
        if len(get_mechanism(candidate.kind).strengths) == 1:
            groups.setdefault(candidate.kind, []).append(candidate)
    found += [look.together(members) for members in groups.values() if len(members) > 1]
    return sorted(found, key=lambda candidate: -candidate.gain)


def location_of(causes: Sequence[Cause]) -> str:
    """Of one cause; of a group `body:*`."""
    return causes[0].location if len(causes) == 1 else causes[0].location.split(":")[0] + ":*"


def places(simulator: Simulator) -> list[tuple[str, str]]:
    """Every kind that moves something at every location of the model, but for sensors that
    measured nothing."""
    shown = zip(sensors(simulator.base), simulator.data.is_measured(), strict=True)
    absent = {f"sensor:{name}" for name, is_measured in shown if not is_measured}
    return [
        (mechanism.kind, location)
        for mechanism in MECHANISMS.values()
        if not mechanism.only_spreads
        for location in mechanism.locations(simulator.base)
        if location not in absent
    ]


class _Scan:
    """Looks at one possible cause after the other, linearised."""

    def __init__(self, fit: Fit, effects: "Effects"):
        self._fit, self._effects = fit, effects
        self._without = fit.held_out
        self._whitener = Whitener.of(fit.linear.chain, fit.noise)
        known = np.concatenate([fit.linear.columns, fit.linear.residual[..., None]], axis=3)
        self._z = self._whitener.whiten(known)

    def alone(self, kind: str, location: str) -> Candidate:
        """The candidate at the best of the sizes where its effect may differ."""
        mechanism, typical = get_mechanism(kind), self._typical(kind, location)
        best = self._nothing([Cause(kind, location, tuple(typical.tolist()))])
        for factor in mechanism.sizes:
            found = self._at([Cause(kind, location, tuple((factor * typical).tolist()))])
            if found is None or (found.gain <= best.gain and best.gain > 0):
                continue
            no_gain = found.gain <= 0
            best = replace(found, causes=best.causes, gains=best.gains) if no_gain else found
        return best

    def together(self, members: Sequence[Candidate]) -> Candidate:
        """A group, without the places where a strength would make no sense."""
        left = everywhere = [tried for member in members for tried in member.tried]
        while len(left) > 1:
            found = self._at(left)
            if found is None:
                break
            sensible = [_makes_sense(*each) for each in zip(found.causes, left, strict=True)]
            if all(sensible):
                return found
            left = [cause for cause, is_so in zip(left, sensible, strict=True) if is_so]
        return self._nothing(everywhere)

    def _typical(self, kind: str, location: str) -> Vector:
        base = self._fit.simulator.base
        sizes = get_mechanism(kind).typical(base, element_of(base, location))
        return np.asarray(sizes, dtype=np.float64)

    def _nothing(self, causes: Sequence[Cause]) -> Candidate:
        nothing = tuple(replace(c, values=(0.0,) * len(c.values)) for c in causes)
        unseen = np.array([np.inf for cause in causes for _ in cause.values])
        return Candidate(tuple(causes), nothing, np.zeros(len(self._without)), unseen)

    def _at(self, tried: Sequence[Cause]) -> Candidate | None:
        """In proportion to causes of one kind that are tried; None where the data cannot tell.

        One alone that the data ask for with a strength that makes no sense is nothing.
        """
        effects = np.concatenate([self._effects.of(cause) for cause in tried], axis=3)
        effects = np.where(self._fit.linear.chain.mask[..., None, None], effects, 0.0)
        if not np.all(np.isfinite(effects)):
            return None
        design = self._whitener.whiten(effects)
        sizes = np.concatenate([cause.values for cause in tried])
        own = products(design, design)
        cross = products(self._z[..., :-1], design)
        score = products(design, self._z[..., -1:])[..., 0]
        normal = self._fit.normal.with_columns(own, cross, score)
        change, covariance = normal.change()
        count = len(sizes)
        variance, alone = np.diagonal(covariance)[-count:], np.diagonal(own.sum(axis=0))
        seen = (variance > 0) & (variance * alone < _ABSORBED) & (variance < _UNSEEN)
        if not seen.any():
            return None
        deviations = np.where(seen, np.sqrt(np.abs(variance)) * np.abs(sizes), np.inf)
        strengths = np.where(seen, change[-count:] * sizes, 0.0)
        gains = normal.left_out() - self._without
        split = np.split(strengths, len(tried))
        found = tuple(
            replace(c, values=tuple(v.tolist())) for c, v in zip(tried, split, strict=True)
        )
        if len(tried) == 1 and not _makes_sense(found[0], tried[0]):
            return replace(self._nothing(tried), deviations=deviations)
        return Candidate(tuple(tried), found, gains, deviations)


def _makes_sense(found: Cause, tried: Cause) -> bool:
    """Whether strengths are possible, and of the side that was tried."""
    mechanism = get_mechanism(found.kind)
    values, low = np.array(found.values), [strength.low for strength in mechanism.strengths]
    is_other_side = mechanism.has_sides and np.any(values * tried.values < 0)
    return bool(np.all(values >= low) and not is_other_side)


class Effects:
    """What possible causes add to the predictions of a fit, each simulated once for all scans, of
    later fits too.

    What acts in a sensor or on a command is a combination of what is known of states and commands
    already; all else is simulated once for each strength.
    """

    def __init__(self, fit: Fit):
        self._fit, self._simulator = fit, fit.simulator
        known = (fit.parameters, fit.causes, fit.states)
        self._predicted = self._simulator.predict_quickly(*known)
        self._slope = self._simulator.slope(*known)
        self._obeyed = self._simulator.told(fit.causes, self._simulator.steps)
        self._responses: dict[int, Matrix] = {}
        self._found: dict[Cause, np.ndarray] = {}

    def of(self, cause: Cause) -> np.ndarray:
        """(E, T, m, strengths) what each strength adds, one after the other."""
        if cause not in self._found:
            mechanism = get_mechanism(cause.kind)
            if mechanism.sense is not None:
                self._found[cause] = self._felt(cause)
            elif mechanism.command is not None:
                self._found[cause] = self._told(cause)
            else:
                self._found[cause] = self._simulated(cause)
            self._found[cause][~self._fit.linear.chain.mask] = 0.0  # nothing is known there
        return self._found[cause]

    def _simulated(self, cause: Cause) -> np.ndarray:
        fit, steps, sizes = self._fit, [self._predicted], np.array(cause.values)
        for count in range(1, len(sizes) + 1):
            values = np.where(np.arange(len(sizes)) < count, sizes, 0.0)
            causes = (*fit.causes, replace(cause, values=tuple(values.tolist())))
            steps.append(self._simulator.predict_quickly(fit.parameters, causes, fit.states))
        return fit.layout.fold(np.diff(np.stack(steps, axis=2), axis=2))

    def _felt(self, cause: Cause) -> np.ndarray:
        """A sensor shows something else before the step, and after it."""
        simulator, fit = self._simulator, self._fit
        column, before = simulator.felt(cause, fit.states, self._slope)
        starts = fit.states[simulator.starts]
        slope = (self._predicted - starts) / simulator.period
        _, after = simulator.felt(cause, self._predicted, slope)
        folded = fit.layout.fold(np.column_stack([before[simulator.starts], after]))
        effect = -fit.linear.chain.transition[..., column] * folded[..., :1]
        effect[..., column] += folded[..., 1]
        return effect[..., None]

    def _told(self, cause: Cause) -> np.ndarray:
        """An actuator obeys something else, on average over a control step."""
        simulator, fit = self._simulator, self._fit
        actuator = element_of(simulator.base, cause.location)
        obeyed = simulator.told((*fit.causes, cause), simulator.steps) - self._obeyed
        change = obeyed[:, :, actuator].mean(axis=1)
        return fit.layout.fold(self._response(actuator) * change[:, None])[..., None]

    def _response(self, actuator: int) -> Matrix:
        """(N, m) what one unit of command adds; simulated once for all effects on it."""
        if actuator not in self._responses:
            self._responses[actuator] = self._respond(actuator)
        return self._responses[actuator]

    def _respond(self, actuator: int) -> Matrix:
        fit, size = self._fit, 0.01 * self._simulator.reach(actuator)
        known = (fit.parameters, fit.causes, fit.states)
        without, more = (
            self._simulator.predict_unclamped(*known, actuator, s) for s in (0.0, size)
        )
        return (more - without) / size
