"""Effects and forces that are as strong, in motions of a hidden robot, as a ratio to noise says.

    sizing = Sizing(nominal, motions)     # a recording without effects and without noise
    effect = sizing.draw_effect(rng, ratio=0.3)

The ratio is that of two root mean squares over all readings: of what an effect changes in one
control step, beyond what free parameters can absorb, and of the noise of a prediction of one step.
That is the noise of the reading itself, and that of the readings before it as the robot passes it
on: where a foot touches the ground, a millimetre is much.
"""

from collections.abc import Collection, Sequence
from dataclasses import replace
from functools import cached_property

import mujoco
import numpy as np

from adr_service.arrays import Matrix, Vector
from adr_service.blind_test.outside import OUTSIDE, Force
from adr_service.criticism.measurements import Measurement
from adr_service.criticism.nominal import Nominal
from adr_service.criticism.simulator import Simulator
from adr_service.effects.base import Effect, JointState
from adr_service.effects.catalogue import MECHANISMS, get_mechanism
from adr_service.effects.models import element_of, shapes_of, typical_of
from adr_service.errors import InvalidInput, UnknownName

MOST_TIED = 3  # effects in the largest tie that the score still counts as naming one
_POSITION_NOISE, _VELOCITY_NOISE = 1e-3, 1e-2  # [rad or m], [rad/s or m/s]
_ADJUSTMENTS = 6  # of an effect's size, which is not always in proportion to its strength
_MOST_DRAWS = 200  # of effects, one after the other, that cannot be as strong
# smallest share of what an effect changes that free parameters, or another effect, must not change
_OF_ITS_OWN = 0.05
_SMALL = 0.1  # times typical: so little changes in proportion to its strength
_FIRST = 2  # episodes in which effects are compared with each other
# planted on whole arms (benchmarks/arms.py); here its mass is often not identifiable, and then it
# is a shifted centre of mass by another name
_ELSEWHERE = ("body_load",)
_ANGLES = 1000  # in a turn, at which a friction may not be negative
_SHAPED = (4.0, 12.0)  # times typical: strengths that say how the others act
_NOT_NEGATIVE = (
    *("dof_damping", "dof_dampingpoly", "dof_armature", "jnt_stiffness", "jnt_stiffnesspoly"),
    *("body_mass", "geom_margin"),
)


def noise_of(model: mujoco.MjModel) -> Vector:
    """(2 nq,) deviation of a reading."""
    return np.repeat([_POSITION_NOISE, _VELOCITY_NOISE], model.nq)


def plantable(model: mujoco.MjModel) -> list[tuple[str, str]]:
    """Kind and place of every effect that a model's robot may hide."""
    return [
        (kind, place)
        for kind, mechanism in MECHANISMS.items()
        if may_be_hidden(kind)
        for place in mechanism.locations(model)
    ]


def may_be_hidden(kind: str) -> bool:
    """True if cases of a blind test hide effects of this kind."""
    return not get_mechanism(kind).only_spreads and kind not in _ELSEWHERE


class Sizing:
    """Motions of a hidden robot, in which effects are sized."""

    def __init__(self, nominal: Nominal, motions: Measurement):
        self._nominal, self._motions = nominal, motions
        self._undisturbed = _Responses(nominal, motions)
        self._base = self._undisturbed.simulator.base
        self._places = plantable(self._base)
        self._small: dict[tuple[str, str], Matrix] = {}

    def draw_effect(
        self, rng: np.random.Generator, ratio: float, kinds: Collection[str] = MECHANISMS
    ) -> Effect:
        """A random effect of these kinds, as strong as `ratio` says to 30 %.

        Raises UnknownName for a kind that the catalogue lacks, and InvalidInput if none can be as
        strong.
        """
        for kind in kinds:
            if kind not in MECHANISMS:
                raise UnknownName("effect", kind, MECHANISMS)
        places = [place for place in self._places if place[0] in kinds]
        for _ in range(_MOST_DRAWS if places else 0):
            kind, place = places[int(rng.integers(len(places)))]
            if (effect := self._sized(kind, place, rng, ratio)) is not None:
                return effect
        raise InvalidInput(
            f"{_MOST_DRAWS} draws of {sorted(kinds)}, which this robot may have at {len(places)} "
            f"places, gave no effect of ratio {ratio:g} that could be named"
        )

    def draw_force(self, rng: np.random.Generator, ratio: float) -> Force:
        """A random force outside the catalogue, as strong as `ratio` says.

        Raises InvalidInput where free parameters explain all that it changes.
        """
        kind = OUTSIDE[int(rng.integers(len(OUTSIDE)))]
        actuator, other = rng.permutation(self._base.nu)[:2].tolist()
        joint = int(self._base.actuator_trnid[actuator, 0])
        unit = Force(kind, int(self._base.jnt_dofadr[joint]), actuator, other, 1.0)
        reached = _rms(self._undisturbed.unabsorbed_force(unit))
        if reached == 0:
            raise InvalidInput(
                f"a {kind} at degree of freedom {unit.dof} changes nothing that free parameters "
                "do not explain as well; draw another"
            )
        return replace(unit, size=ratio / reached)

    def are_equal(self, effect: Effect, kind: str, place: str) -> bool:
        """True if an effect of this kind at this place can reproduce the response to `effect`, to
        5 %, in the first episodes; False where they show no response."""
        return self._can_explain(self._small_response(effect), kind, place)

    def _can_explain(self, change: Vector, kind: str, place: str) -> bool:
        columns = self._small_responses(kind, place)
        strengths = np.linalg.lstsq(columns, change, rcond=None)[0]
        low = np.array([strength.low for strength in get_mechanism(kind).strengths])
        left = np.linalg.norm(change - columns @ strengths)
        is_possible = bool(np.all((strengths >= 0) | (low < 0)))
        return bool(left < _OF_ITS_OWN * np.linalg.norm(change)) and is_possible

    def _sized(
        self, kind: str, place: str, rng: np.random.Generator, ratio: float
    ) -> Effect | None:
        """A random effect as strong as `ratio` says; None where it cannot be, or not be named."""
        mechanism = get_mechanism(kind)
        typical = typical_of(self._base, kind, place)
        mixed = rng.uniform(0.5, 1.0, len(typical)) if len(typical) > 1 else np.ones(1)
        signs = [1.0 if s.low == 0 else rng.choice([-1.0, 1.0]) for s in mechanism.strengths]
        values = typical * mixed * np.array(signs)
        is_shape = shapes_of(kind)
        if is_shape.any():
            values = np.where(is_shape, rng.uniform(*_SHAPED) * typical, values)
        effect, reached = Effect(kind, place, tuple(values.tolist())), 0.0
        for number in range(_ADJUSTMENTS):
            effect = replace(effect, values=tuple(values.tolist()))
            reached = _rms(self._undisturbed.unabsorbed(effect))
            if not np.isfinite(reached) or reached <= 1e-9:
                return None
            if abs(reached / ratio - 1) < 0.05 or number == _ADJUSTMENTS - 1:
                break
            values = values * np.where(is_shape, 1.0, np.clip(ratio / reached, 0.1, 10.0))
        low = np.array([s.low for s in mechanism.strengths])
        is_sized = abs(reached / ratio - 1) <= 0.3 and not np.any(values < low)
        return effect if is_sized and self._is_physical(effect) and self._is_rare(effect) else None

    def _is_physical(self, effect: Effect) -> bool:
        """True if no physical quantity is negative, and delays are shorter than a step."""
        friction = get_mechanism(effect.kind).friction
        if friction is not None:
            turn = JointState(np.linspace(0, 2 * np.pi, _ANGLES), np.zeros(_ANGLES))
            dof = self._base.jnt_dofadr[element_of(self._base, effect.location)]
            added = friction.added(turn, np.array(effect.values))
            return bool(np.all(added + self._base.dof_frictionloss[dof] >= 0))
        model = self._nominal.model(self._nominal.start, [effect])
        is_late = effect.kind in ("actuator_delay", "sensor_delay")
        if is_late and effect.values[0] > self._undisturbed.simulator.period:
            return False
        return all(np.all(getattr(model, name) >= 0) for name in _NOT_NEGATIVE)

    def _is_rare(self, effect: Effect) -> bool:
        """True if so few others can reproduce it that a tie with them still counts as a name."""
        change = self._small_response(effect)
        others = [each for each in self._places if each != (effect.kind, effect.location)]
        return sum(self._can_explain(change, *place) for place in others) < MOST_TIED

    @cached_property
    def _first(self) -> "_Responses":
        return _Responses(self._nominal, self._motions.episodes(range(_FIRST)))

    def _small_response(self, effect: Effect) -> Vector:
        """(N m,) response of the first episodes to a little of an effect."""
        return self._first.unabsorbed(_shrunk(self._base, effect))

    def _small_responses(self, kind: str, place: str) -> Matrix:
        """(N m, k) response of the first episodes to a little of each strength, but for shapes."""
        if (kind, place) not in self._small:
            typical, is_shape = typical_of(self._base, kind, place), shapes_of(kind)
            columns: list[Vector] = []
            for number, size in enumerate(typical):
                values = np.where(is_shape, typical, 0.0)
                if not is_shape[number]:
                    values[number] = _SMALL * size
                effect = Effect(kind, place, tuple(values.tolist()))
                columns.append(self._first.unabsorbed(effect))
            self._small[kind, place] = np.stack(columns, axis=1)
        return self._small[kind, place]


class _Responses:
    """Responses of one step of motions to effects and forces, in units of its noise."""

    def __init__(self, nominal: Nominal, motions: Measurement):
        self.simulator, self._start = Simulator(nominal, motions, threads=1), nominal.start
        self._states = self.simulator.measured
        self._predicted = self._predict(self._states, self._start)
        reading = noise_of(self.simulator.base)
        passed_on = np.zeros_like(self._predicted)  # variance
        for error in (*np.diag(reading), *np.diag(-reading)):
            change = self._predict(self._states + error, self._start) - self._predicted
            passed_on += np.nan_to_num(change) ** 2 / 2
        self._noise = np.sqrt(reading**2 + passed_on)
        columns: list[Vector] = []
        for number in range(len(self._start)):
            moved = self._start.copy()
            moved[number] *= 1.001
            columns.append(self._in_noise(self._predict(self._states, moved) - self._predicted))
        size = self._predicted.size
        self._parameters = np.stack(columns, axis=1) if columns else np.zeros((size, 1))

    def unabsorbed(self, effect: Effect) -> Vector:
        """(N m,) response to an effect, but for what free parameters can absorb; zero where they
        can absorb almost all."""
        changed = self._predict(self._states, self._start, [effect])
        return self._beside_parameters(self._in_noise(changed - self._predicted))

    def unabsorbed_force(self, force: Force) -> Vector:
        """(N m,) the same for a force that stays, within each step, what it is at its start."""
        by_unit = self.simulator.responses_to_forces(self._start, (), self._states)[force.dof]
        return self._beside_parameters(self._in_noise(by_unit * self._at_starts(force)[:, None]))

    def _at_starts(self, force: Force) -> Vector:
        """(N,) the force [N or N m] at the start of each step, in the recording's order."""
        simulator = self.simulator
        data, now = mujoco.MjData(simulator.base), np.empty(len(self._states))
        for row, state in enumerate(self._states):
            data.qpos[:], data.qvel[:] = np.split(state, 2)
            data.ctrl[:] = simulator.data.ctrl[row]
            now[row] = force.at(data, row * simulator.period, len(now) * simulator.period)
        return now[simulator.starts]

    def _beside_parameters(self, response: Vector) -> Vector:
        """A response without what free parameters absorb; zero where they can absorb almost all."""
        absorbed = np.linalg.lstsq(self._parameters, response, rcond=None)[0]
        left = response - self._parameters @ absorbed
        is_its_own = np.linalg.norm(left) >= _OF_ITS_OWN * np.linalg.norm(response)
        return left if is_its_own else np.zeros_like(left)

    def _predict(
        self, states: Matrix, parameters: Vector, effects: Sequence[Effect] = ()
    ) -> Matrix:
        return self.simulator.predict(parameters, effects, states)

    def _in_noise(self, change: Matrix) -> Vector:
        return np.nan_to_num(change / self._noise).ravel()


def _shrunk(model: mujoco.MjModel, effect: Effect) -> Effect:
    """An effect of the same signs and proportions, but small, so that it acts in proportion."""
    typical, is_shape = typical_of(model, effect.kind, effect.location), shapes_of(effect.kind)
    largest = np.max(np.abs(effect.values)[~is_shape] / typical[~is_shape])
    values = np.where(is_shape, 1.0, _SMALL / largest) * effect.values
    return Effect(effect.kind, effect.location, tuple(values.tolist()))


def _rms(response: Vector) -> float:
    return float(np.sqrt(np.mean(response**2)))
