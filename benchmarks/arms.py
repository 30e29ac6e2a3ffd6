"""Blind test of criticism on whole arms, where many things are wrong at once, as on real ones.

    python -m benchmarks.arms [--axes 6 7] [--seeds 10] [--nulls]

Fewer axes are the first ones of the six.

The nominal model of an arm has no friction and no rotor inertia. The robot has Coulomb and viscous
friction and rotor inertia at every joint, compensates the gravity of every link wrongly, and
carries a load off the axis at its last link. It is integrated by another integrator in a quarter of
the step, follows smooth motions in closed loop, and torques that are not recorded act on it,
correlated in time. With `--nulls` the model has all that the robot has, but for these torques.
5,000 transitions each. As many processes at once as there are cores (set OMP_NUM_THREADS=1). Prints
a line for each case: the causes named, the largest relative error of a friction or rotor inertia,
that of the load's mass, CPU seconds.
"""

import argparse
import os
import time
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from itertools import product

import mujoco
import numpy as np

from adr_service.arrays import Matrix, Vector
from adr_service.criticism.extension import extend
from adr_service.criticism.measurements import Measurement
from adr_service.criticism.nominal import Nominal
from adr_service.criticism.pipeline import Criticism, criticise
from adr_service.criticism.simulator import other_integrator
from adr_service.effects.base import Effect
from adr_service.parameters import ParameterSpace

EPISODES, ROWS, PERIOD = 50, 101, 0.01  # [s] between rows
_FINER = 4
_POSITION_NOISE, _VELOCITY_NOISE = 1e-4, 2e-3  # [rad], [rad/s]
_TORQUE_NOISE, _KEPT = 0.003, 0.8  # of an actuator's range; from one row to the next
_SWINGS, _SLOWEST, _FASTEST = 4, 0.2, 1.2  # sines of a joint's motion, and their frequencies [Hz]
_STIFF, _DAMPED = 60.0, 12.0  # feedback of the controller [1/s²], [1/s], times a joint's inertia


@dataclass(frozen=True)
class Link:
    """A link of an arm, which turns about an axis of the link before."""

    axis: str
    offset: str  # [m] of its joint, in the frame of the link before
    length: float  # [m] along its own z
    radius: float  # [m]
    mass: float  # [kg]
    torque: float  # [N m] largest of its drive
    armature: float  # [kg m²] of the real drive


_SHOULDER = (
    Link("0 0 1", "0 0 0.08", 0.10, 0.07, 3.6, 150.0, 0.55),
    Link("0 1 0", "0 0.08 0.06", 0.40, 0.06, 8.0, 150.0, 0.55),
)
_WRIST = (
    Link("0 1 0", "0 0.05 0.33", 0.09, 0.04, 1.3, 30.0, 0.10),
    Link("0 0 1", "0 0.04 0.05", 0.09, 0.04, 1.2, 30.0, 0.10),
    Link("0 1 0", "0 0.03 0.10", 0.06, 0.035, 0.4, 30.0, 0.10),
)
ARMS: dict[int, tuple[Link, ...]] = {
    6: (
        *_SHOULDER,
        Link("0 1 0", "0 -0.08 0.40", 0.36, 0.05, 2.8, 120.0, 0.35),
        *_WRIST,
    ),
    7: (
        *_SHOULDER,
        Link("0 0 1", "0 -0.05 0.38", 0.08, 0.05, 2.6, 100.0, 0.35),
        Link("0 1 0", "0 0.05 0.08", 0.34, 0.05, 2.6, 100.0, 0.35),
        *_WRIST,
    ),
}


def links_of(axes: int) -> tuple[Link, ...]:
    """The links of an arm with 1 to 7 axes."""
    return ARMS[axes] if axes in ARMS else ARMS[min(ARMS)][:axes]


def model_of(links: Sequence[Link]) -> str:
    """MJCF of an arm without friction and rotor inertia, whose drives compensate gravity."""
    opened = [
        f'<body name="link{i}" pos="{link.offset}" gravcomp="1">'
        f'<joint name="joint{i}" axis="{link.axis}"/>'
        f'<geom type="cylinder" size="{link.radius} {link.length / 2}" mass="{link.mass}" '
        f'pos="0 0 {link.length / 2}" contype="0" conaffinity="0"/>'
        for i, link in enumerate(links, 1)
    ]
    motors = [
        f'<motor name="motor{i}" joint="joint{i}" ctrllimited="true" '
        f'ctrlrange="-{link.torque} {link.torque}"/>'
        for i, link in enumerate(links, 1)
    ]
    return (
        '<mujoco><option timestep="0.002" integrator="implicitfast"/><worldbody>'
        + "".join(opened)
        + "</body>" * len(links)
        + f"</worldbody><actuator>{''.join(motors)}</actuator></mujoco>"
    )


def hidden(links: Sequence[Link], rng: np.random.Generator) -> list[Effect]:
    """All that the robot has and its model lacks."""
    effects: list[Effect] = []
    for i, link in enumerate(links, 1):
        for kind, strength in (
            ("joint_coulomb_friction", link.torque * rng.uniform(0.02, 0.08)),
            ("joint_viscous_friction", link.torque * rng.uniform(0.02, 0.08)),
            ("joint_armature", link.armature * rng.uniform(0.7, 1.3)),
        ):
            effects.append(Effect(kind, f"joint:joint{i}", (float(strength),)))
        error = float(rng.uniform(0.03, 0.08) * rng.choice([-1.0, 1.0]))
        effects.append(Effect("gravity_compensation", f"body:link{i}", (error,)))
    mass, place = rng.uniform(0.8, 1.6), rng.uniform([-0.05, -0.05, 0.05], [0.05, 0.05, 0.15])
    load = (float(mass), *(mass * place).tolist())
    return [*effects, Effect("body_load", f"body:link{len(links)}", load)]


def recorded(
    nominal: Nominal, links: Sequence[Link], effects: Sequence[Effect], rng: np.random.Generator
) -> Measurement:
    """Closed-loop motions of the robot with these effects."""
    model = nominal.model(nominal.start, effects)
    model.opt.timestep /= _FINER
    model.opt.integrator = other_integrator(model.opt.integrator)
    data, skip = mujoco.MjData(model), round(PERIOD / model.opt.timestep)
    torque = np.array([link.torque for link in links])
    states = np.empty((EPISODES, ROWS, 2 * model.nv))
    commands = np.empty((EPISODES, ROWS, len(links)))
    noise = np.repeat([_POSITION_NOISE, _VELOCITY_NOISE], model.nv)
    beside = np.zeros(model.nv)
    for episode in range(EPISODES):
        motion = _Motion.drawn(rng, model.nv)
        mujoco.mj_resetData(model, data)
        data.qpos[:], data.qvel[:], _ = motion.at(0.0)
        for row in range(ROWS):
            shown = np.concatenate([data.qpos, data.qvel])
            shown = shown + noise * rng.standard_normal(2 * model.nv)
            command = np.clip(_torque(model, data, motion.at(row * PERIOD), shown), -torque, torque)
            states[episode, row], commands[episode, row] = shown, command
            fresh = np.sqrt(1 - _KEPT**2) * rng.standard_normal(model.nv)
            beside = _KEPT * beside + fresh
            data.ctrl[: len(links)] = command
            data.qfrc_applied[:] = _TORQUE_NOISE * torque * beside
            mujoco.mj_step(model, data, nstep=skip)
    flat = states.reshape(EPISODES * ROWS, -1)
    return Measurement(
        time=np.tile(np.arange(ROWS) * PERIOD, EPISODES),
        qpos=flat[:, : model.nq],
        qvel=flat[:, model.nq :],
        ctrl=commands.reshape(EPISODES * ROWS, -1),
        episode=np.repeat(np.arange(EPISODES), ROWS),
    )


@dataclass(frozen=True)
class _Motion:
    """A sum of sines for each joint."""

    amplitude: Matrix  # (nv, sines) [rad]
    rate: Matrix  # [rad/s]
    phase: Matrix

    @classmethod
    def drawn(cls, rng: np.random.Generator, joints: int) -> "_Motion":
        shape = (joints, _SWINGS)
        rate = 2 * np.pi * np.exp(rng.uniform(np.log(_SLOWEST), np.log(_FASTEST), shape))
        return cls(rng.uniform(0.2, 0.6, shape), rate, rng.uniform(0, 2 * np.pi, shape))

    def at(self, seconds: float) -> tuple[Vector, Vector, Vector]:
        """Positions, velocities and accelerations (nv,)."""
        angle, amplitude = self.rate * seconds + self.phase, self.amplitude
        return (
            np.sum(amplitude * np.sin(angle), axis=1),
            np.sum(amplitude * self.rate * np.cos(angle), axis=1),
            np.sum(-amplitude * self.rate**2 * np.sin(angle), axis=1),
        )


def _torque(
    model: mujoco.MjModel, data: mujoco.MjData, wanted: tuple[Vector, Vector, Vector], shown: Vector
) -> Vector:
    """Torques (nv,) of a controller that knows the robot's inertia, and sees its sensors."""
    inertia = np.empty((model.nv, model.nv))
    mujoco.mj_forward(model, data)
    mujoco.mj_fullM(model, data, inertia)
    position, velocity, acceleration = wanted
    q, v = np.split(shown, 2)
    return inertia @ (acceleration + _STIFF * (position - q) + _DAMPED * (velocity - v))


def one(job: tuple[int, int, bool]) -> str:
    """The line of one case."""
    axes, seed, is_null = job
    rng, links = np.random.default_rng([axes, seed]), links_of(axes)
    nominal = Nominal.of_model(model_of(links), ParameterSpace(()))
    effects = hidden(links, rng)
    data = recorded(nominal, links, effects, rng)
    if is_null:
        nominal = extend(nominal, nominal.start, effects).nominal()
    started = time.process_time()
    criticism = criticise(nominal, data, rng, threads=1)
    seconds = time.process_time() - started
    causes = [f"{c.kind} {c.location}" for c in criticism.verdict.causes]
    named = ", ".join(causes) or criticism.verdict.conclusion.value
    errors = "" if is_null else _errors(criticism, effects)
    return f"{axes} axes, seed {seed}: {named}; {errors}{seconds:.0f} CPU s"


def _errors(criticism: Criticism, effects: Sequence[Effect]) -> str:
    """Largest relative errors of strengths; of what is not named, one."""
    named = {(e.kind, e.location): e.values[0] for e in criticism.final.effects}
    errors: dict[str, float] = {}
    for effect in effects:
        if effect.kind != "gravity_compensation":
            off = abs(named.get((effect.kind, effect.location), 0.0) / effect.values[0] - 1)
            errors[effect.kind] = max(errors.get(effect.kind, 0.0), off)
    return "".join(f"{kind} {off:.1%}, " for kind, off in errors.items())


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    choices = range(1, max(ARMS) + 1)
    parser.add_argument("--axes", nargs="+", type=int, choices=choices, default=list(ARMS))
    parser.add_argument("--seeds", type=int, default=10)
    parser.add_argument("--nulls", action="store_true")
    given = parser.parse_args()
    jobs = [(axes, seed, given.nulls) for seed, axes in product(range(given.seeds), given.axes)]
    with ProcessPoolExecutor(len(os.sched_getaffinity(0))) as pool:
        for line in pool.map(one, jobs):
            print(line, flush=True)


if __name__ == "__main__":
    main()
