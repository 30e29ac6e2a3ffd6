"""A linear regression of everything that a simulator misses on terms of missing effects.

    regression = regression_of(nominal, measurement, parameters)
    regression.target                   # (N,) errors of all sensors, in their deviations
    regression.columns                  # (N, p) what each of `regression.terms` would add

One-step errors are differences of noisy readings: e' = n' - A n, with the noise n and the
simulator's derivative A by the state. Accumulated along an episode, z' = e' + A z, they are the
noise itself, independent from row to row, but for what the first reading's noise leaves, which is
projected out. Terms accumulate likewise. So do the changes by the free parameters, which are
projected out too. Terms are functions of the row before and of the prediction from it, because the
next reading has the very noise that is in its error.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import mujoco
import numpy as np

from adr_service.arrays import Array3, Matrix, Vector
from adr_service.criticism.measurements import Measurement
from adr_service.criticism.nominal import Nominal
from adr_service.criticism.simulator import Simulator
from adr_service.effects.base import sensors
from benchmarks.baselines.fitting import by_parameters, one_step, simulator_of, without

_STICK = 0.05  # [rad/s or m/s] over which Coulomb friction changes its sign
_MOVED = 1e-6  # [SI] of a state, for its derivatives


@dataclass(frozen=True)
class Term:
    """A function of one joint's state, of one command or of one reading, and where it acts."""

    symbol: str
    element: str  # joint, actuator or sensor that it is a function of; "": constant
    place: str  # joint whose force it adds to, or sensor whose reading


@dataclass(frozen=True)
class Regression:
    """Errors of all sensors in all transitions, and what terms add to them."""

    terms: list[Term]
    columns: Matrix  # (N, p), of size one; N: transitions times sensors
    scales: Vector  # (p,) sizes that the columns had, in deviations per unit of the term
    target: Vector  # (N,) in deviations
    errors: Matrix  # (n, m) accumulated, without first states and free parameters, in deviations
    deviations: Vector  # (m,) of the sensors, if nothing is missing


def regression_of(nominal: Nominal, data: Measurement, parameters: Vector) -> Regression:
    """The regression of a simulator with these parameters."""
    with simulator_of(nominal, data) as simulator:
        predict = one_step(simulator, parameters, np.empty(0))
        missed, moved = predict(parameters, ()), by_parameters(predict, parameters)
        forced = list(_forced(simulator, nominal.model(parameters), missed))
        read = list(_read(simulator, missed))
        derivatives = _derivatives(simulator, parameters)
    added = np.stack([values for _, values in forced], axis=2)
    all_values = np.concatenate([missed[..., None], moved, added], axis=2)
    values, firsts = _accumulated(simulator, derivatives, all_values)
    values = np.concatenate([values, np.stack([values for _, values in read], axis=2)], axis=2)
    unweighted = _unexplained(simulator, firsts, values, len(parameters))
    deviations = np.sqrt(np.mean(unweighted[:, 0].reshape(missed.shape) ** 2, axis=0))
    firsts, values = firsts / deviations[:, None], values / deviations[:, None]
    rest = _unexplained(simulator, firsts, values, len(parameters))
    scales = np.sqrt(np.mean(rest[:, 1:] ** 2, axis=0))
    seen = scales > 1e-9 * scales.max()
    terms = [term for term, _ in (*forced, *read)]
    return Regression(
        [term for term, is_seen in zip(terms, seen, strict=True) if is_seen],
        rest[:, 1:][:, seen] / scales[seen],
        scales[seen],
        rest[:, 0],
        rest[:, 0].reshape(missed.shape),
        deviations,
    )


def _forced(
    simulator: Simulator, model: mujoco.MjModel, missed: Matrix
) -> Iterator[tuple[Term, Matrix]]:
    """Terms as forces on each joint, and what they add within a row to all states (n, 2 nv)."""
    nv, period = model.nv, simulator.period
    per_force = _velocities_per_force(model, simulator.measured[simulator.starts], period)
    joints = [model.joint(int(model.dof_jntid[dof])).name for dof in range(nv)]
    for symbol, element, values in _functions(simulator, missed[:, nv:], joints):
        for dof, joint in enumerate(joints):
            faster = values[:, None] * per_force[:, :, dof]
            # a constant force moves a joint by half of what its last velocity would
            yield Term(symbol, element, joint), np.hstack([period / 2 * faster, faster])


def _functions(
    simulator: Simulator, missed: Matrix, joints: list[str]
) -> Iterator[tuple[str, str, Vector]]:
    """Symbol, element and values (n,) of everything that a force may depend on."""
    nv, starts, model = len(joints), simulator.starts, simulator.base
    states, commands = simulator.measured[starts], simulator.data.ctrl
    accelerations = (simulator.measured[starts + 1, nv:] - missed - states[:, nv:]) / (
        simulator.period
    )
    is_first = ~np.isin(starts - 1, starts)
    before = np.where(is_first[:, None], commands[starts], commands[starts - 1])
    lengths = [end - begin for begin, end in simulator.transitions()]
    elapsed = np.concatenate([simulator.period * np.arange(length) for length in lengths])
    yield "1", "", np.ones(len(starts))
    for dof, joint in enumerate(joints):
        q, v = states[:, dof], states[:, nv + dof]
        yield "q", joint, q
        yield "q³", joint, q**3
        yield "sin q", joint, np.sin(q)
        yield "cos q", joint, np.cos(q)
        yield "v", joint, v
        yield "v > 0", joint, np.maximum(v, 0.0)
        yield "sign v", joint, np.tanh(v / _STICK)
        yield "v|v|", joint, v * np.abs(v)
        yield "a", joint, accelerations[:, dof]
    for number in range(commands.shape[1]):
        name, u = model.actuator(number).name, commands[starts, number]
        yield "u", name, u
        yield "u before", name, before[:, number] - u
        yield "sign u", name, np.sign(u)
        yield "u|u|", name, u * np.abs(u)
        yield "u t", name, u * elapsed


def _read(simulator: Simulator, missed: Matrix) -> Iterator[tuple[Term, Matrix]]:
    """Offset, scale and delay of each sensor, and what they add to all readings (n, 2 nv)."""
    starts, period = simulator.starts, simulator.period
    now, ahead = simulator.measured[starts], simulator.measured[starts + 1] - missed
    for column, name in enumerate(sensors(simulator.base)):
        for symbol, values in (
            ("bias", np.ones(len(starts))),
            ("scale", ahead[:, column]),
            ("rate", (ahead - now)[:, column] / period),
        ):
            added = np.zeros_like(now)
            added[:, column] = values
            yield Term(symbol, name, name), added


def _velocities_per_force(model: mujoco.MjModel, states: Matrix, period: float) -> Array3:
    """(n, nv, nv) changes of velocity by constant forces of one within a period, at states.

    Of what such a force does, damping takes some back before the period is over (first order).
    """
    data, inertias = mujoco.MjData(model), np.empty((len(states), model.nv, model.nv))
    for state, inertia in zip(states, inertias, strict=True):
        data.qpos[:] = state[: model.nq]
        mujoco.mj_fwdPosition(model, data)
        mujoco.mj_fullM(model, data, inertia)
    forces: Array3 = inertias / period + np.diag(model.dof_damping) / 2
    identity = np.broadcast_to(np.eye(model.nv), forces.shape)
    return np.linalg.solve(forces, identity).astype(np.float64)


def _derivatives(simulator: Simulator, parameters: Vector) -> Array3:
    """(n, m, m) of the next states by the states."""
    plain = simulator.predict(parameters, (), simulator.measured)
    columns: list[Matrix] = []
    for column in range(plain.shape[1]):
        moved = simulator.measured.copy()
        moved[:, column] += _MOVED
        columns.append((simulator.predict(parameters, (), moved) - plain) / _MOVED)
    return np.stack(columns, axis=2)


def _accumulated(
    simulator: Simulator, derivatives: Array3, values: Array3
) -> tuple[Array3, Array3]:
    """Values (n, m, k) along their episodes, and the effect (n, m, m) of first states."""
    added, firsts = np.empty_like(values), np.empty_like(derivatives)
    for begin, end in simulator.transitions():
        total, first = np.zeros(values.shape[1:]), np.eye(values.shape[1])
        for row in range(begin, end):
            total = values[row] + derivatives[row] @ total
            first = derivatives[row] @ first
            added[row], firsts[row] = total, first
    return added, firsts


def _unexplained(simulator: Simulator, firsts: Array3, values: Array3, d: int) -> Matrix:
    """(n m, k - d) of values (n, m, k) what neither first states nor the d free parameters explain,
    whose changes are the columns after the first."""
    left = np.empty_like(values)
    for begin, end in simulator.transitions():
        flat = values[begin:end].reshape(-1, values.shape[2])
        explained = firsts[begin:end].reshape(-1, firsts.shape[2])
        left[begin:end] = without(explained, flat).reshape(values[begin:end].shape)
    flat = left.reshape(-1, left.shape[2])
    return without(flat[:, 1 : 1 + d], np.delete(flat, np.s_[1 : 1 + d], axis=1))
