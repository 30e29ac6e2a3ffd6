"""Planted effects: measurements of a hidden robot, to see whether criticism names what it has.

    case = draw_case(task, nominal, rng, ratio=0.3)
    case.measurement                    # all that the diagnosis may see, besides the nominal model
    case.effects                        # the effects that it should name

The hidden robot is not the diagnosed model: it is integrated four times more finely by another
integrator, its parameters differ from those that the diagnosis starts from, and its sensors are
noisy. The size of an effect is set by its ratio to the noise: root mean squares, over all columns,
of what it changes in one control step and of what noise adds to a difference of two readings.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import mujoco
import numpy as np

from adr_service.arrays import Array3, Matrix, Vector
from adr_service.blind_test.outside import OUTSIDE, Force, Outside, Push
from adr_service.criticism.measurements import Measurement
from adr_service.criticism.nominal import Nominal
from adr_service.criticism.simulator import Simulator, other_integrator
from adr_service.effects.base import Effect, JointState
from adr_service.effects.catalogue import MECHANISMS, get_mechanism
from adr_service.effects.friction import Losses, varies
from adr_service.effects.models import element_of, shapes_of, typical_of
from adr_service.effects.signals import obeyed, recorded
from adr_service.errors import InvalidInput
from adr_service.tasks.base import State, Task

EPISODES, STEPS = 30, 75
_FINER = 4
_POSITION_NOISE, _VELOCITY_NOISE = 1e-3, 1e-2  # [rad or m], [rad/s or m/s]
_ADJUSTMENTS = 6  # of an effect's size, which is not always in proportion to its strength
_TOLD_APART = 0.05  # of an effect, that no free parameter may absorb
# planted on whole arms (benchmarks/arms.py); here its mass is often not identifiable, and then it
# is a shifted centre of mass by another name
_ELSEWHERE = ("body_load",)
_ANGLES = 1000  # in a turn, at which a friction may not be negative
_SHAPED = (4.0, 12.0)  # times typical: strengths that say how the others act
_OFF = 0.1  # relative error of the parameters that the diagnosis starts from


@dataclass(frozen=True)
class Case:
    """A measurement, the model to be diagnosed, and the truth that is hidden in it."""

    nominal: Nominal
    measurement: Measurement
    effects: tuple[Effect, ...]  # in the catalogue
    outside: Outside | None  # not in it
    ratio: float  # of the effect to the noise
    truth: Vector  # (d,) parameters of the hidden robot


def draw_case(
    task: Task,
    nominal: Nominal,
    rng: np.random.Generator,
    ratio: float,
    count: int = 1,
    outside: bool = False,
) -> Case:
    """A case with `count` random effects of the catalogue, or one outside of it.

    `nominal.start` is the hidden truth; the case's nominal starts elsewhere.
    """
    truth = nominal.start
    start = truth * (1 + _OFF * rng.uniform(-1, 1, len(truth)))
    wrong = replace(nominal, start=start)
    robot = _Robot(task, nominal)
    hidden: list[Effect] = []
    force: Force | None = None
    if outside:
        force = robot.sized_force(rng, ratio)
    while len(hidden) < count and not outside:
        effect = robot.sized_effect(rng, ratio)
        if effect is not None and effect.location not in [e.location for e in hidden]:
            hidden.append(effect)
    measurement = robot.record(rng, hidden, force)
    return Case(wrong, measurement, tuple(hidden), force.kind if force else None, ratio, truth)


def hide(
    task: Task,
    nominal: Nominal,
    rng: np.random.Generator,
    effects: Sequence[Effect],
    force: Push | None = None,
    commands: Array3 | None = None,
) -> Measurement:
    """A measurement of a robot that has `nominal.start` for parameters, and these effects.

    `commands` (episodes, rows, nu): what its actuators get; None: coloured noise.
    """
    return _Robot(task, nominal).record(rng, effects, force, commands)


def sized_effect(task: Task, nominal: Nominal, rng: np.random.Generator, ratio: float) -> Effect:
    """A random effect of the catalogue that is as strong as `ratio` says."""
    robot = _Robot(task, nominal)
    while (effect := robot.sized_effect(rng, ratio)) is None:
        pass
    return effect


def noise_of(model: mujoco.MjModel) -> Vector:
    """(2 nq,) deviation of a difference of two readings."""
    return np.sqrt(2) * np.repeat([_POSITION_NOISE, _VELOCITY_NOISE], model.nq)


def plantable(model: mujoco.MjModel) -> list[tuple[str, str]]:
    """Kind and place of every effect that may be hidden in a model's robot."""
    return [
        (kind, place)
        for kind, mechanism in MECHANISMS.items()
        if may_be_hidden(kind)
        for place in mechanism.locations(model)
    ]


def may_be_hidden(kind: str) -> bool:
    """True if cases of a blind test hide effects of this kind."""
    return not get_mechanism(kind).only_spreads and kind not in _ELSEWHERE


@dataclass(frozen=True)
class _Pilot:
    """A short recording of the hidden robot, and what its free parameters would change of it."""

    simulator: Simulator
    states: Matrix  # (rows, m)
    predicted: Matrix  # (N, m)
    columns: Matrix  # (N m, d) in units of the noise


class _Robot:
    """The hidden robot: the nominal model at its truth, integrated well."""

    def __init__(self, task: Task, nominal: Nominal):
        self._task, self._nominal = task, nominal
        self._base = nominal.model(nominal.start)
        self._places = plantable(self._base)

    def sized_effect(self, rng: np.random.Generator, ratio: float) -> Effect | None:
        """A random effect as strong as `ratio` says; None where it cannot be."""
        kind, place = self._places[int(rng.integers(len(self._places)))]
        mechanism = get_mechanism(kind)
        typical = typical_of(self._base, kind, place)
        mixed = rng.uniform(0.5, 1.0, len(typical)) if len(typical) > 1 else np.ones(1)
        signs = [1.0 if s.low == 0 else rng.choice([-1.0, 1.0]) for s in mechanism.strengths]
        values = typical * mixed * np.array(signs)
        is_shape = shapes_of(kind)
        if is_shape.any():
            values = np.where(is_shape, rng.uniform(*_SHAPED) * typical, values)
        reached = 0.0
        for number in range(_ADJUSTMENTS):
            reached = self._ratio_of(Effect(kind, place, tuple(values.tolist())))
            if not np.isfinite(reached) or reached <= 1e-9:
                return None
            if abs(reached / ratio - 1) < 0.05 or number == _ADJUSTMENTS - 1:
                break
            values = values * np.where(is_shape, 1.0, np.clip(ratio / reached, 0.1, 10.0))
        effect = Effect(kind, place, tuple(values.tolist()))
        low = np.array([s.low for s in mechanism.strengths])
        is_sized = abs(reached / ratio - 1) <= 0.3 and not np.any(values < low)
        return effect if is_sized and self._is_physical(effect) else None

    def _is_physical(self, effect: Effect) -> bool:
        """True if no physical quantity is negative, and delays are shorter than a step."""
        friction = get_mechanism(effect.kind).friction
        if friction is not None:
            turn = JointState(np.linspace(0, 2 * np.pi, _ANGLES), np.zeros(_ANGLES))
            dof = self._base.jnt_dofadr[element_of(self._base, effect.location)]
            added = friction.added(turn, np.array(effect.values))
            return bool(np.all(added + self._base.dof_frictionloss[dof] >= 0))
        model = self._nominal.model(self._nominal.start, [effect])
        fields = (model.dof_damping, model.dof_armature, model.jnt_stiffness, model.body_mass)
        sensible = all(np.all(field >= 0) for field in fields) and np.all(model.geom_margin >= 0)
        late = effect.kind in ("actuator_delay", "sensor_delay") and effect.values[0] > self._period
        return bool(sensible and not late)

    def sized_force(self, rng: np.random.Generator, ratio: float) -> Force:
        kind = OUTSIDE[int(rng.integers(len(OUTSIDE)))]
        actuator, other = rng.permutation(self._base.nu)[:2].tolist()
        joint = int(self._base.actuator_trnid[actuator, 0])
        dof = int(self._base.jnt_dofadr[joint])
        pilot = self._pilot
        gear = abs(float(self._base.actuator_gear[actuator, 0]))
        force = 0.01 * gear
        still, pushed = (
            pilot.simulator.predict_pushed(self._nominal.start, (), pilot.states, dof, size)
            for size in (0.0, force)
        )
        changed = (pushed - still) / noise_of(self._base)
        per_newton = float(np.sqrt(np.nanmean(changed**2))) / force
        # root mean square of a force of size one, roughly
        unit = {"gain_drift": 0.17, "cross_coupling": 0.55}.get(kind, 0.7)
        return Force(kind, dof, actuator, other, ratio / (per_newton * unit))

    def record(
        self,
        rng: np.random.Generator,
        effects: Sequence[Effect],
        force: Push | None,
        commands: Array3 | None = None,
    ) -> Measurement:
        """A measurement by the robot's sensors."""
        if commands is None:
            commands = np.stack([_commands(rng, self._task, STEPS + 1) for _ in range(EPISODES)])
        # sensors are late, and joints cross their gaps, between two rows as well
        states = self._run(rng, commands, effects, force)
        fine = self._period / self._steps
        shown = recorded(self._base, effects, states, fine)[:, :: self._steps]
        nq = self._base.nq
        scale = np.repeat([_POSITION_NOISE, _VELOCITY_NOISE], nq)
        return self._measurement(shown + scale * rng.standard_normal(shown.shape), commands)

    @property
    def _period(self) -> float:
        return self._base.opt.timestep * self._task.frame_skip

    @property
    def _steps(self) -> int:
        """Steps from one row to the next."""
        return self._task.frame_skip * _FINER

    def _ratio_of(self, effect: Effect) -> float:
        pilot = self._pilot
        start = self._nominal.start
        changed = pilot.simulator.predict(start, [effect], pilot.states)
        return self._in_noise(changed - pilot.predicted)

    def _in_noise(self, effect: Matrix) -> float:
        """Root mean square of what the free parameters cannot absorb of an effect (N, m)."""
        effect = np.nan_to_num(effect / noise_of(self._base)).ravel()
        absorbed = np.linalg.lstsq(self._pilot.columns, effect, rcond=None)[0]
        left = effect - self._pilot.columns @ absorbed
        if np.linalg.norm(left) < _TOLD_APART * np.linalg.norm(effect):
            return 0.0  # it is a free parameter by another name
        return float(np.sqrt(np.mean(left**2)))

    @cached_property
    def _pilot(self) -> _Pilot:
        """A recording without any effect and without noise, to size effects with."""
        rng = np.random.default_rng(0)  # the same for all cases of a robot
        commands = np.stack([_commands(rng, self._task, STEPS + 1) for _ in range(8)])
        states = self._run(rng, commands, [], None)[:, :: self._steps]
        simulator = Simulator(self._nominal, self._measurement(states, commands), threads=1)
        start = self._nominal.start
        predicted = simulator.predict(start, (), simulator.measured)
        columns: list[Vector] = []
        for number in range(len(start)):
            moved = start.copy()
            moved[number] *= 1.001
            changed = simulator.predict(moved, (), simulator.measured)
            columns.append(np.nan_to_num((changed - predicted) / noise_of(self._base)).ravel())
        design = np.stack(columns, axis=1) if columns else np.zeros((predicted.size, 1))
        return _Pilot(simulator, simulator.measured, predicted, design)

    def _measurement(self, states: Array3, commands: Array3) -> Measurement:
        episodes, rows, _ = states.shape
        flat, nq = states.reshape(episodes * rows, -1), self._base.nq
        return Measurement(
            time=np.tile(np.arange(rows) * self._period, episodes),
            qpos=flat[:, :nq],
            qvel=flat[:, nq:],
            ctrl=commands.reshape(episodes * rows, -1),
            episode=np.repeat(np.arange(episodes), rows),
        )

    def _run(
        self,
        rng: np.random.Generator,
        commands: Array3,
        effects: Sequence[Effect],
        force: Push | None,
    ) -> Array3:
        """True states (episodes, rows * steps, 2 nv) at the beginning of each step; raises
        InvalidInput where they diverge."""
        model = self._nominal.model(self._nominal.start, effects)
        model.opt.timestep /= _FINER
        model.opt.integrator = other_integrator(self._base.opt.integrator)
        skip, (episodes, rows) = self._steps, commands.shape[:2]
        initial = self._task.initial(episodes, rng)
        finer = np.repeat(commands, skip, axis=1)
        applied = obeyed(self._base, effects, finer, model.opt.timestep)
        length = episodes * rows * self._period
        data, states = mujoco.MjData(model), np.empty((episodes, rows * skip, 2 * model.nv))
        losses, has_friction = Losses(model, effects), varies(effects)
        for episode in range(episodes):
            _place(model, data, initial, episode, rng)
            for row in range(rows):
                for step in range(row * skip, (row + 1) * skip):
                    states[episode, step] = np.concatenate([data.qpos, data.qvel])
                    data.ctrl[: applied.shape[2]] = applied[episode, step]
                    if force is not None:
                        now = (episode * rows + row) * self._period
                        seconds = now + (step % skip) * model.opt.timestep
                        data.qfrc_applied[force.dof] = force.at(data, seconds, length)
                    if has_friction:
                        now = (each[None] for each in (data.qpos, data.qvel, data.ctrl))
                        model.dof_frictionloss[:] = losses.at(*now)[0]
                    mujoco.mj_step(model, data)
        if not np.all(np.abs(states) < 1e6):
            raise InvalidInput("the hidden robot diverged; draw another")
        return states


def _place(
    model: mujoco.MjModel,
    data: mujoco.MjData,
    initial: State,
    episode: int,
    rng: np.random.Generator,
) -> None:
    """Put the robot near an initial state, and lift it where it can be lifted."""
    mujoco.mj_resetData(model, data)
    data.qpos[:] = initial.qpos[episode] + 0.05 * rng.standard_normal(model.nq)
    data.qvel[:] = initial.qvel[episode] + 0.3 * rng.standard_normal(model.nv)
    lifted = _lift(model)
    if lifted is not None:
        data.qpos[lifted] += rng.uniform(0.05, 0.4)


def _lift(model: mujoco.MjModel) -> int | None:
    """The position that raises the whole robot: a vertical slide of its root."""
    for joint in range(model.njnt):
        is_slide = model.jnt_type[joint] == mujoco.mjtJoint.mjJNT_SLIDE
        if is_slide and abs(model.jnt_axis[joint, 2]) > 0.9:
            return int(model.jnt_qposadr[joint])
    return None


def _commands(rng: np.random.Generator, task: Task, rows: int) -> Matrix:
    """(rows, nu) coloured noise within the task's bounds, each actuator at its own pace."""
    low, high = task.action_low, task.action_high
    keep = rng.uniform(0.6, 0.95, len(low))
    noise = rng.standard_normal((rows, len(low)))
    values = np.empty_like(noise)
    state = np.zeros(len(low))
    for row in range(rows):
        state = keep * state + np.sqrt(1 - keep**2) * noise[row]
        values[row] = state
    return low + (np.clip(0.6 * values, -1, 1) + 1) / 2 * (high - low)
