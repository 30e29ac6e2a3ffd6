"""Planted effects: measurements of a hidden robot, to see whether criticism names what it has.

    case = draw_case(task, nominal, rng, ratio=0.3)
    case.measurement                    # all that the diagnosis may see, besides the nominal model
    case.effects                        # the effects that it should name

The hidden robot is not the diagnosed model: it is integrated four times more finely by another
integrator, its parameters differ from those that the diagnosis starts from, and its sensors are
noisy. Effects are as strong in the case's own motions as their ratio says (`sizing`).
"""

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import mujoco
import numpy as np

from adr_service.arrays import Array3, Matrix, Vector
from adr_service.blind_test.outside import Force, Outside, Push
from adr_service.blind_test.sizing import Sizing, noise_of
from adr_service.criticism.measurements import Measurement
from adr_service.criticism.nominal import Nominal
from adr_service.criticism.simulator import other_integrator
from adr_service.effects.base import Effect
from adr_service.effects.catalogue import MECHANISMS
from adr_service.effects.friction import Losses, varies
from adr_service.effects.signals import obeyed, recorded
from adr_service.errors import InvalidInput
from adr_service.tasks.base import State, Task

EPISODES, STEPS = 30, 75
_FINER = 4
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

    `nominal.start` is the hidden truth; the case's nominal starts elsewhere. Raises InvalidInput
    where the robot diverges, or nothing can be of this ratio.
    """
    truth = nominal.start
    start = truth * (1 + _OFF * rng.uniform(-1, 1, len(truth)))
    wrong = replace(nominal, start=start)
    robot = _Robot(task, nominal, rng)
    hidden: list[Effect] = []
    force: Force | None = None
    if outside:
        force = robot.sizing.draw_force(rng, ratio)
    while len(hidden) < count and not outside:
        effect = robot.sizing.draw_effect(rng, ratio)
        if not any(_are_one(robot.sizing, effect, other) for other in hidden):
            hidden.append(effect)
    measurement = robot.record(rng, hidden, force)
    return Case(wrong, measurement, tuple(hidden), force.kind if force else None, ratio, truth)


def _are_one(sizing: Sizing, effect: Effect, other: Effect) -> bool:
    """True if two effects are at one place, or either can reproduce the other."""
    return (
        effect.location == other.location
        or sizing.are_equal(effect, other.kind, other.location)
        or sizing.are_equal(other, effect.kind, effect.location)
    )


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
    return _Robot(task, nominal, rng, commands).record(rng, effects, force)


def sized_effect(
    task: Task,
    nominal: Nominal,
    rng: np.random.Generator,
    ratio: float,
    kinds: Collection[str] = MECHANISMS,
) -> Effect:
    """A random effect of one of these kinds, as strong as `ratio` says in motions drawn for it.

    Raises InvalidInput where none can be.
    """
    return _Robot(task, nominal, rng).sizing.draw_effect(rng, ratio, kinds)


class _Robot:
    """The hidden robot in one recording: the nominal model at its truth, integrated well, with
    commands and starts that are drawn once."""

    def __init__(
        self,
        task: Task,
        nominal: Nominal,
        rng: np.random.Generator,
        commands: Array3 | None = None,
    ):
        self._task, self._nominal = task, nominal
        self._base = nominal.model(nominal.start)
        if commands is None:
            commands = np.stack([_commands(rng, task, STEPS + 1) for _ in range(EPISODES)])
        self._commands = commands  # (episodes, rows, nu)
        self._starts = _starts(self._base, task.initial(len(commands), rng), rng)

    @cached_property
    def sizing(self) -> Sizing:
        """Its motions without effects and noise; raises InvalidInput where they diverge."""
        states = self._run([], None)[:, :: self._steps]
        return Sizing(self._nominal, self._measurement(states))

    def record(
        self, rng: np.random.Generator, effects: Sequence[Effect], force: Push | None
    ) -> Measurement:
        """A measurement by the robot's sensors, whose noise is drawn."""
        # sensors are late, and joints cross their gaps, between two rows as well
        states = self._run(effects, force)
        fine = self._period / self._steps
        shown = recorded(self._base, effects, states, fine)[:, :: self._steps]
        noise = noise_of(self._base) * rng.standard_normal(shown.shape)
        return self._measurement(shown + noise)

    @property
    def _period(self) -> float:
        return self._base.opt.timestep * self._task.frame_skip

    @property
    def _steps(self) -> int:
        """Steps from one row to the next."""
        return self._task.frame_skip * _FINER

    def _measurement(self, states: Array3) -> Measurement:
        episodes, rows, _ = states.shape
        flat, nq = states.reshape(episodes * rows, -1), self._base.nq
        return Measurement(
            time=np.tile(np.arange(rows) * self._period, episodes),
            qpos=flat[:, :nq],
            qvel=flat[:, nq:],
            ctrl=self._commands.reshape(episodes * rows, -1),
            episode=np.repeat(np.arange(episodes), rows),
        )

    def _run(self, effects: Sequence[Effect], force: Push | None) -> Array3:
        """True states (episodes, rows * steps, 2 nv) at the beginning of each step; raises
        InvalidInput where they diverge."""
        model = self._nominal.model(self._nominal.start, effects)
        model.opt.timestep /= _FINER
        model.opt.integrator = other_integrator(self._base.opt.integrator)
        skip, (episodes, rows) = self._steps, self._commands.shape[:2]
        finer = np.repeat(self._commands, skip, axis=1)
        applied = obeyed(self._base, effects, finer, model.opt.timestep)
        length = episodes * rows * self._period
        data, states = mujoco.MjData(model), np.empty((episodes, rows * skip, 2 * model.nv))
        losses, has_friction = Losses(model, effects), varies(effects)
        for episode in range(episodes):
            mujoco.mj_resetData(model, data)
            data.qpos[:], data.qvel[:] = np.split(self._starts[episode], 2)
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


def _starts(model: mujoco.MjModel, initial: State, rng: np.random.Generator) -> Matrix:
    """(episodes, 2 nv) states near the initial ones, lifted where the robot can be lifted."""
    starts: list[Vector] = []
    lifted = _lift(model)
    for qpos, qvel in zip(initial.qpos, initial.qvel, strict=True):
        position = qpos + 0.05 * rng.standard_normal(model.nq)
        velocity = qvel + 0.3 * rng.standard_normal(model.nv)
        if lifted is not None:
            position[lifted] += rng.uniform(0.05, 0.4)
        starts.append(np.concatenate([position, velocity]))
    return np.stack(starts)


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
