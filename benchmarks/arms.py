"""Blind test of criticism on whole arms, where many things are wrong at once, as on real ones.

    python -m benchmarks.arms [--axes 6 7] [--seeds 10] [--nulls]

Fewer axes are the first ones of the six.

The nominal model of an arm has no friction and no rotor inertia. The robot has Coulomb and viscous
friction and rotor inertia at every joint, compensates the gravity of every link wrongly, and
carries a load off the axis at its last link. It is integrated by another integrator in a quarter of
the step, follows smooth motions in closed loop, and torques that are not recorded act on it,
correlated in time. With `--nulls` the model has all that the robot has, but for these torques.
5,000 transitions each. As many processes at once as there are cores (set OMP_NUM_THREADS=1). Prints
a line for each case: what was named, the largest relative error of a friction or rotor inertia,
that of the load's mass, CPU seconds. Writes build/bench/arms.json (arms-nulls.json) after every
case, and goes on from there where it was interrupted, while the method is the same.
"""

import argparse
import time
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from adr_service.arrays import Matrix, Vector
from adr_service.criticism.extension import extend
from adr_service.criticism.measurements import Measurement
from adr_service.criticism.nominal import Nominal
from adr_service.criticism.pipeline import criticise
from adr_service.criticism.remarks import on_implausible
from adr_service.criticism.simulator import other_integrator
from adr_service.effects.base import Effect
from adr_service.parameters import ParameterSpace
from benchmarks.ended_cases import all_cases, digest_of

PATH = Path("build/bench/arms.json")
METHOD = (
    *("adr_service/criticism", "adr_service/effects", "adr_service/simulation"),
    "benchmarks/arms.py",
)
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


def one(job: tuple[int, int, bool]) -> dict[str, Any]:
    """One case: what was hidden, what was named of it, and what was named beside it."""
    axes, seed, is_null = job
    rng, links = np.random.default_rng([axes, seed]), links_of(axes)
    nominal = Nominal.of_model(model_of(links), ParameterSpace(()))
    effects = hidden(links, rng)
    data = recorded(nominal, links, effects, rng)
    if is_null:
        nominal = extend(nominal, nominal.start, effects).nominal()
    ended = {"axes": axes, "seed": seed, "is_null": is_null}
    started = time.process_time()
    try:
        criticism = criticise(nominal, data, rng, threads=1)
    except Exception as error:  # noqa: BLE001 - the others go on; the table counts it
        return {**ended, "failed": f"{type(error).__name__}: {error}"}
    seconds = time.process_time() - started
    planted = {} if is_null else {(e.kind, e.location): e.values[0] for e in effects}
    named = {(e.kind, e.location): e.values[0] for e in criticism.final.effects}
    verdict, final = criticism.verdict, criticism.final
    return {
        **ended,
        "conclusion": verdict.conclusion.value,
        "rest": verdict.residual.rest,
        "causes": [f"{c.kind} {c.location}" for c in verdict.causes],
        "errors": {
            f"{kind} {place}": abs(named[kind, place] / value - 1)
            for (kind, place), value in planted.items()
            if (kind, place) in named
        },
        "missed": sorted(f"{kind} {place}" for kind, place in planted.keys() - named.keys()),
        "false": sorted(f"{kind} {place}" for kind, place in named.keys() - planted.keys()),
        "implausible": list(on_implausible(final.simulator.base, final.effects)),
        "moment_error": None if is_null else _moment_error(effects, final.effects),
        "cpu_seconds": seconds,
    }


def _moment_error(planted: Sequence[Effect], named: Sequence[Effect]) -> float | None:
    """Relative error of the load's first moments (3,); None if the load is not named."""
    places = {effect.location: effect for effect in planted if effect.kind == "body_load"}
    for effect in named:
        if effect.kind == "body_load" and effect.location in places:
            true, found = (np.array(e.values[1:]) for e in (places[effect.location], effect))
            return float(np.linalg.norm(found - true) / np.linalg.norm(true))
    return None


def _job(case: dict[str, Any]) -> tuple[int, int, bool]:
    return case["axes"], case["seed"], case["is_null"]


def _line(case: dict[str, Any]) -> str:
    opening = f"{case['axes']} axes, seed {case['seed']}"
    if "failed" in case:
        return f"{opening} failed: {case['failed']}"
    named = ", ".join(case["causes"]) or case["conclusion"]
    errors = "".join(f"{kind} {_worst(case, kind):.1%}, " for kind in _kinds(case))
    missed = "".join(f"not {name}, " for name in case["missed"])
    return f"{opening}: {named}; {errors}{missed}{case['cpu_seconds']:.0f} CPU s"


def _kinds(case: dict[str, Any]) -> list[str]:
    """Kinds of effects that were planted and named, without the compensation of gravity."""
    return sorted({name.split()[0] for name in case["errors"]} - {"gravity_compensation"})


def _worst(case: dict[str, Any], kind: str) -> float:
    return max(off for name, off in case["errors"].items() if name.split()[0] == kind)


def table(cases: Sequence[dict[str, Any]]) -> str:
    """Lines that count the cases that are right, of those that ended."""
    ended = [case for case in cases if "failed" not in case]
    lines = {"failed": f"{len(cases) - len(ended)} of {len(cases)}"}
    if not ended:
        return f"failed: {lines['failed']}"
    lines |= _of_nulls(ended) if ended[0]["is_null"] else _of_planted(ended)
    seconds = np.percentile([case["cpu_seconds"] for case in ended], [0, 50, 100])
    lines["CPU seconds (smallest, median, largest)"] = ", ".join(f"{s:.0f}" for s in seconds)
    return "\n".join(f"{name}: {value}" for name, value in lines.items())


def _of_planted(cases: Sequence[dict[str, Any]]) -> dict[str, str]:
    joints = ("joint_coulomb_friction", "joint_viscous_friction", "joint_armature")
    return {
        "nothing false named": _count(not case["false"] for case in cases),
        "nothing missed": _count(not case["missed"] for case in cases),
        "frictions and rotors within 15 %": _count(_is_within(c, joints, 0.15) for c in cases),
        "load's mass within 10 %": _count(_is_within(c, ("body_load",), 0.1) for c in cases),
        "load's moments within 10 %": _count(
            case["moment_error"] is not None and case["moment_error"] <= 0.1 for case in cases
        ),
        "nothing implausible named": _count(not case["implausible"] for case in cases),
        "strengths of compensation within 15 %": _compensated(cases),
    }


def _compensated(cases: Sequence[dict[str, Any]]) -> str:
    """Count of the named strengths that are that close; links' weights stand in for each other."""
    errors = [
        off
        for case in cases
        for name, off in case["errors"].items()
        if name.startswith("gravity_compensation")
    ]
    return f"{sum(off <= 0.15 for off in errors)} of {len(errors)} named"


def _is_within(case: dict[str, Any], kinds: Sequence[str], most: float) -> bool:
    """True if all effects of these kinds are named, with errors of at most this."""
    has_all = not any(name.split()[0] in kinds for name in case["missed"])
    return has_all and all(_worst(case, kind) <= most for kind in kinds)


def _of_nulls(cases: Sequence[dict[str, Any]]) -> dict[str, str]:
    return {
        "nothing named": _count(not case["causes"] for case in cases),
        "nothing called unknown": _count(case["rest"] == "none" for case in cases),
    }


def _count(right: Iterable[bool]) -> str:
    each = list(right)
    return f"{sum(each)} of {len(each)}"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    choices = range(1, max(ARMS) + 1)
    parser.add_argument("--axes", nargs="+", type=int, choices=choices, default=list(ARMS))
    parser.add_argument("--seeds", type=int, default=10)
    parser.add_argument("--nulls", action="store_true")
    given = parser.parse_args()
    jobs = [(axes, seed, given.nulls) for seed, axes in product(range(given.seeds), given.axes)]
    path = PATH.with_stem("arms-nulls") if given.nulls else PATH
    ended = all_cases(path, {"code": digest_of(*METHOD)}, jobs, one, _job, _line)
    print(table(ended))


if __name__ == "__main__":
    main()
