"""The simulator under criticism: what it predicts one control step ahead of every measured state.

    simulator = Simulator(nominal, measurement)
    predicted = simulator.predict(parameters, causes, states)      # (N, 2 nv)

States are in the sensors' coordinates, positions then velocities. An effect in a sensor is undone
before the simulation and applied again after it.
"""

import os
from collections.abc import Generator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
from mujoco import rollout

from adr_service.arrays import Array3, Indices, Matrix, Vector
from adr_service.causes import Cause
from adr_service.criticism.measurements import Measurement
from adr_service.errors import InvalidInput
from adr_service.parameters import ParameterSpace
from adr_service.simulation.mechanism import Commands, is_added
from adr_service.simulation.mechanisms import element_of, get_mechanism, openly, with_causes
from adr_service.simulation.model import link_of, read, resolve, write
from adr_service.tasks.base import Reshapable, Source, Task

_CONTROL = mujoco.mjtState.mjSTATE_CTRL | mujoco.mjtState.mjSTATE_QFRC_APPLIED
_MOST_STEPS = 500  # of the simulator between two rows
_MOST_NUMBERS = 2e8  # of one array of a criticism: 1.6 GB


@dataclass(frozen=True)
class Nominal:
    """A simulator that may be wrong: a model and its free parameters."""

    xml: str
    space: ParameterSpace  # what may be fitted before anything is called wrong
    start: Vector  # (d,) where the fit begins [SI]
    fixed: Mapping[str, float] = field(default_factory=dict[str, float])  # address -> value
    task: Task | None = None  # whose links can be reshaped, where lengths are parameters
    folder: str = ""  # in which the model looks for meshes and textures; written out as well

    @classmethod
    def of_task(cls, task: Task, source: Source) -> "Nominal":
        """A task's simulator as its file has it; all of a source's parameters are free, but for
        link lengths, which stay. Raises InvalidInput where the source has effects already."""
        if source.causes:
            raise InvalidInput(f"{task.name} is extended already; criticise it as its file has it")
        free = [p.name for p in source.space.parameters if link_of(p.address) is None]
        return cls.of_model(task.xml, source.space.subset(tuple(free)), source.fixed, task)

    @classmethod
    def of_model(
        cls,
        xml: str,
        space: ParameterSpace,
        fixed: Mapping[str, float] | None = None,
        task: Task | None = None,
        folder: str = "",
    ) -> "Nominal":
        """A model whose free parameters start at the values that its file has."""
        whole = cls(xml, ParameterSpace(()), np.empty(0), fixed or {}, task, folder)
        model = whole.model(whole.start)
        start = [read(model, resolve(model, p.address)) for p in space.parameters]
        for p, value in zip(space.parameters, start, strict=True):
            if not p.feasible_low <= value <= p.high:
                raise InvalidInput(
                    f"the model has {value:g} for {p.name}, which is outside of its bounds: "
                    f"{p.feasible_low:g} to {p.high:g}"
                )
        return cls(xml, space, np.array(start), fixed or {}, task, folder)

    def model(self, values: Vector, causes: Sequence[Cause] = ()) -> mujoco.MjModel:
        """The compiled model with parameters (d,) and causes."""
        return with_causes(self.spec(values), lambda model: self.write(model, values), causes)

    def spec(self, values: Vector) -> mujoco.MjSpec:
        """The model's source, reshaped where lengths are parameters."""
        try:
            spec = mujoco.MjSpec.from_string(self.xml)
        except ValueError as error:
            raise InvalidInput(f"MuJoCo cannot read the model: {error}") from error
        if self.folder:
            paths: Any = spec  # whose stub lacks these two
            paths.meshdir = str(Path(self.folder) / paths.meshdir)
            paths.texturedir = str(Path(self.folder) / paths.texturedir)
        for kind in ("bodies", "joints", "geoms", "actuators"):
            for number, element in enumerate(getattr(spec, kind)):
                element.name = element.name or f"unnamed_{number}"  # a cause needs a place
        openly(spec)
        if spec.compiler.settotalmass > 0:
            raise InvalidInput(
                "the model scales its masses by settotalmass, which no cause in a body survives; "
                "write the masses out (MjSpec.to_xml does) and leave it away"
            )
        known = self.addressed(values)
        lengths = {link: value for a, value in known.items() if (link := link_of(a)) is not None}
        if lengths:
            assert isinstance(self.task, Reshapable)
            self.task.reshape(spec, lengths)
        return spec

    def addressed(self, values: Vector) -> dict[str, float]:
        """All values that the simulator takes, by address."""
        addresses = [parameter.address for parameter in self.space.parameters]
        return {**self.fixed, **dict(zip(addresses, values.tolist(), strict=True))}

    def write(self, model: mujoco.MjModel, values: Vector) -> None:
        """Put parameters (d,) into a compiled model."""
        for address, value in self.addressed(values).items():
            if link_of(address) is None:
                write(model, resolve(model, address), value)


class Simulator:
    """Predicts all transitions of one measurement, under any parameters and causes."""

    def __init__(
        self, nominal: Nominal, data: Measurement, threads: int | None = None, finer: int = 1
    ):
        """`finer`: how many of its steps are taken for one of the model's."""
        self.nominal, self.data, self.finer = nominal, data, finer
        self.base = nominal.model(nominal.start)
        _check(self.base, data)
        self.period = data.period()
        self.steps = finer * _steps(self.period, self.base.opt.timestep)
        self.starts: Indices = np.flatnonzero(np.diff(data.episode) == 0)  # (N,) of transitions
        self.measured = np.concatenate([data.qpos, data.qvel], axis=1)  # (rows, 2 nv)
        self._pool = rollout.Rollout(nthread=_threads(threads))
        self._scratch = [mujoco.MjData(self.base) for _ in range(max(1, _threads(threads)))]
        self._rough = 1  # of its steps, that differences take for one of the model's
        if finer > 1 and np.isnan(self.predict_quickly(nominal.start, (), self.measured)).any():
            self._rough = finer  # the model's own step diverges

    def __enter__(self) -> "Simulator":
        return self

    def __exit__(self, *_: object) -> None:
        """Ends its threads; it predicts nothing more."""
        self._pool.close()

    def predict(self, values: Vector, causes: Sequence[Cause], states: Matrix) -> Matrix:
        """Measured states (N, 2 nv) one control step after `states` (rows, 2 nv).

        NaN where the simulation diverged.
        """
        return self._predict(causes, states, self._model(values, causes))

    def follow(self, values: Vector, causes: Sequence[Cause]) -> Matrix:
        """Measured states (rows, 2 nv), whole episodes simulated from their first rows on.

        NaN where the simulation diverged.
        """
        model = self._model(values, causes)
        model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_AUTORESET
        told, spans = self.told(causes, self.steps), self.data.spans()
        true = self._true(causes, self.measured, model)
        shown = self.measured.copy()
        for (first, last), (begin, end) in zip(spans, self._transitions(), strict=True):
            control = np.zeros((1, (end - begin) * self.steps, model.nu))
            control[0, :, : told.shape[2]] = told[begin:end].reshape(-1, told.shape[2])
            with _quiet():
                after, _ = self._pool.rollout(
                    model,
                    self._data(model),
                    np.concatenate([[0.0], true[first]])[None],
                    control,
                    control_spec=int(mujoco.mjtState.mjSTATE_CTRL),
                )
            ends = after[0, self.steps - 1 :: self.steps, 1:].copy()
            ends[~np.all(np.abs(ends) < mujoco.mjMAXVAL, axis=1)] = np.nan
            before = np.concatenate([true[first][None], ends[:-1]])
            shown[first + 1 : last] = self._shown(causes, before, ends)
        return shown

    def predict_quickly(self, values: Vector, causes: Sequence[Cause], states: Matrix) -> Matrix:
        """`predict` with the model's own step, by an integrator of first order: for differences to
        others of this kind.

        Where steps are `finer`, or the model's own integrator is of fourth order, it takes a
        fraction of the time. With the `finer` steps where the model's own diverge.
        """
        return self._predict(causes, states, self._quick(values, causes))

    def predict_finer(
        self,
        values: Vector,
        causes: Sequence[Cause],
        states: Matrix,
        finer: int,
        integrator: int,
    ) -> Matrix:
        """`predict` with a step `finer` times smaller, by one of MuJoCo's integrators."""
        model = self._model(values, causes)
        model.opt.timestep /= finer
        model.opt.integrator = integrator
        return self._predict(causes, states, model)

    def predict_free(self, values: Vector, causes: Sequence[Cause], states: Matrix) -> Matrix:
        """`predict_quickly` without contacts and joint limits in the step that is predicted."""
        model = self._quick(values, causes)
        true = self._true(causes, states, model)
        bits = mujoco.mjtDisableBit
        model.opt.disableflags |= bits.mjDSBL_CONTACT | bits.mjDSBL_LIMIT
        return self._shown(causes, true[self.starts], self._ends(causes, true, model))

    def predict_pushed(
        self, values: Vector, causes: Sequence[Cause], states: Matrix, dof: int, force: float
    ) -> Matrix:
        """`predict_quickly` with a constant generalised force [N or N m] on a degree of freedom."""
        model = self._quick(values, causes)
        return self._predict(causes, states, model, push=(dof, force))

    def reach(self, actuator: int) -> float:
        """The largest command that was given to an actuator, in its unit."""
        return float(np.abs(self.data.ctrl[:, actuator]).max()) or 1.0

    def predict_unclamped(
        self, values: Vector, causes: Sequence[Cause], states: Matrix, actuator: int, more: float
    ) -> Matrix:
        """`predict_quickly` with more told to an actuator than was, and no limits of commands."""
        model = self._quick(values, causes)
        model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_CLAMPCTRL
        return self._predict(causes, states, model, command=(actuator, more))

    def _model(self, values: Vector, causes: Sequence[Cause]) -> mujoco.MjModel:
        with _quiet():
            model = self.nominal.model(values, causes)
        model.opt.timestep /= self.finer
        return model

    def _is_possible(self, model: mujoco.MjModel) -> bool:
        """Whether every body that has a mass and inertias still has."""
        pairs = (
            (self.base.body_mass, model.body_mass),
            (self.base.body_inertia, model.body_inertia),
        )
        return all(np.all((now > mujoco.mjMINVAL) | (was == 0)) for was, now in pairs)

    def _quick(self, values: Vector, causes: Sequence[Cause]) -> mujoco.MjModel:
        model = self._model(values, causes)
        model.opt.timestep *= self.finer / self._rough
        if not is_first_order(model):
            model.opt.integrator = other_integrator(model.opt.integrator)
        return model

    def _predict(
        self,
        causes: Sequence[Cause],
        states: Matrix,
        model: mujoco.MjModel,
        push: tuple[int, float] = (0, 0.0),
        command: tuple[int, float] = (0, 0.0),
    ) -> Matrix:
        true = self._true(causes, states, model)
        ends = self._ends(causes, true, model, push, command)
        return self._shown(causes, true[self.starts], ends)

    def _ends(
        self,
        causes: Sequence[Cause],
        true: Matrix,
        model: mujoco.MjModel,
        push: tuple[int, float] = (0, 0.0),
        command: tuple[int, float] = (0, 0.0),
    ) -> Matrix:
        """The robot's states (N, 2 nv) one control step after its states (rows, 2 nv)."""
        model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_AUTORESET  # divergence must show
        steps, n = round(self.period / model.opt.timestep), len(self.starts)
        if not self._is_possible(model):
            return np.full((n, self.measured.shape[1]), np.nan)
        nq, nv = model.nq, model.nv
        told = self.told(causes, steps)
        full = np.zeros((n, 1 + nq + nv))
        full[:, 1:] = true[self.starts]
        control = np.zeros((n, steps, model.nu + nv))
        control[..., : told.shape[2]] = told
        control[..., command[0]] += command[1]
        control[..., model.nu + push[0]] = push[1]
        with _quiet():
            after, _ = self._pool.rollout(
                model, self._data(model), full, control, control_spec=int(_CONTROL)
            )
        ends = after[:, -1, 1:].copy()
        ends[~np.all(np.abs(ends) < mujoco.mjMAXVAL, axis=1)] = np.nan
        return ends

    def _data(self, model: mujoco.MjModel) -> list[mujoco.MjData]:
        if (model.nu, model.nsite) == (self.base.nu, self.base.nsite):
            return self._scratch
        return [mujoco.MjData(model) for _ in self._scratch]

    def told(self, causes: Sequence[Cause], steps: int) -> Array3:
        """(N, steps, nu) what the actuators obey in each of so many steps between two rows."""
        timestep = self.period / steps
        count = self.data.ctrl.shape[1]  # without actuators that an extension added
        limited = self.base.actuator_ctrllimited[:count].astype(bool)
        bounds = self.base.actuator_ctrlrange[:count].T
        low, high = np.where(limited, bounds, [[-np.inf], [np.inf]])
        given = np.clip(self.data.ctrl[self.starts], low, high)  # as the simulator would
        told = np.repeat(given[:, None], steps, axis=1)
        for cause in causes:
            mechanism = get_mechanism(cause.kind)
            if mechanism.command is None:
                continue
            actuator = element_of(self.base, cause.location)
            largest = float(np.abs(bounds[:, actuator]).max()) if limited[actuator] else np.inf
            for first, last in self._transitions():
                known = told[first:last, :, actuator].reshape(1, -1)
                commands = Commands(known, timestep, largest)
                done = mechanism.command(commands, actuator, np.array(cause.values))
                told[first:last, :, actuator] = done.reshape(last - first, steps)
        return told

    def _transitions(self) -> list[tuple[int, int]]:
        """Half-open ranges of each episode's transitions among `starts`."""
        lengths = [last - first - 1 for first, last in self.data.spans()]
        ends = np.cumsum(lengths).tolist()
        return [(end - length, end) for end, length in zip(ends, lengths, strict=True)]

    def _true(self, causes: Sequence[Cause], states: Matrix, model: mujoco.MjModel) -> Matrix:
        """The robot's states (rows, 2 nv) behind what its sensors show."""
        felt = [cause for cause in causes if get_mechanism(cause.kind).sense is not None]
        if not felt:
            return states
        true, slope = states.copy(), np.zeros_like(states)
        if any(get_mechanism(cause.kind).sense == "delay" for cause in felt):
            slope = self._slope(causes, states, model)
        for cause in reversed(felt):
            column, added = self.felt(cause, states, slope)
            if get_mechanism(cause.kind).sense == "scale":
                added = added / (1 + cause.values[0])  # of what is shown
            true[:, column] -= added
        return true

    def _shown(self, causes: Sequence[Cause], before: Matrix, after: Matrix) -> Matrix:
        """What sensors show after a control step, from true states before and after it."""
        shown = after.copy()
        for cause in causes:
            if get_mechanism(cause.kind).sense is not None:
                column, added = self.felt(cause, after, (after - before) / self.period)
                shown[:, column] += added
        return shown

    def felt(self, cause: Cause, states: Matrix, slope: Matrix) -> tuple[int, Vector]:
        """What a sensor adds to states (n, 2 nv) that change by `slope` [1/s], and its column."""
        place, size = element_of(self.base, cause.location), cause.values[0]
        match get_mechanism(cause.kind).sense:
            case "bias":
                return place, np.full(len(states), size)
            case "scale":
                return place, size * states[:, place]
            case "delay":
                return place, -size * slope[:, place]
            case "backlash":  # of a joint, in its position
                column = int(self.base.jnt_dofadr[place])
                return column, -size / 2 * np.sign(states[:, self.base.nv + column])
            case "quantisation" | "noise":
                return place, np.zeros(len(states))  # on average
            case None:
                raise InvalidInput(f"{cause.kind} is not in a sensor")

    def slope(self, values: Vector, causes: Sequence[Cause], states: Matrix) -> Matrix:
        """(rows, 2 nv) rate of change since the row before, by the model of `predict_quickly`; of
        first rows, as after them.

        Simulated: the measured one would tell the simulator what it is to predict.
        """
        return self._slope(causes, states, self._quick(values, causes))

    def _slope(self, causes: Sequence[Cause], states: Matrix, model: mujoco.MjModel) -> Matrix:
        ends = self._ends(causes, states, model)
        slope = np.zeros_like(states)
        slope[self.starts + 1] = (np.nan_to_num(ends) - states[self.starts]) / self.period
        first = np.array([first for first, _ in self.data.spans()])
        slope[first] = slope[first + 1]
        return slope


def check_measurement(nominal: Nominal, data: Measurement) -> None:
    """Raises InvalidInput where the data are too few, or not of the simulator."""
    data.check_usable()
    data.check_velocities()
    model = nominal.model(nominal.start)
    _check(model, data)
    steps = _steps(data.period(), model.opt.timestep)
    lengths = [last - first for first, last in data.spans()]
    needed = max(len(lengths) * max(lengths) * model.nv, len(data.time) * steps) * model.nv
    if needed > _MOST_NUMBERS:
        raise InvalidInput(
            f"{len(lengths)} episodes, the longest of {max(lengths)} rows, with {steps} steps of "
            f"the model between rows, would take {needed:.2g} numbers at a time; accepted are "
            f"{_MOST_NUMBERS:.2g} (give fewer rows, in episodes of about the same length)"
        )


def is_first_order(model: mujoco.MjModel) -> bool:
    return bool(model.opt.integrator != mujoco.mjtIntegrator.mjINT_RK4)


def other_integrator(integrator: int) -> int:
    """One of another kind: implicit, or where that is it, of fourth order."""
    kinds = mujoco.mjtIntegrator
    implicit = kinds.mjINT_IMPLICITFAST
    return int(kinds.mjINT_RK4 if integrator == implicit else implicit)


@contextmanager
def _quiet() -> Generator[None]:
    """Without MuJoCo's warnings of divergence, on the terminal and in a file: we see it as NaN."""
    mujoco.set_mju_user_warning(lambda text: None)
    try:
        yield
    finally:
        mujoco.set_mju_user_warning(None)


def _check(model: mujoco.MjModel, data: Measurement) -> None:
    if model.nq != model.nv:
        raise InvalidInput(
            f"the model has {model.nq} positions for {model.nv} velocities: free and ball joints "
            "cannot be criticised yet; accepted are slides and hinges"
        )
    beyond = mujoco.mj_stateSize(model, mujoco.mjtState.mjSTATE_FULLPHYSICS) - 1 - 2 * model.nv
    if beyond:
        raise InvalidInput(
            f"the model's state has {beyond} numbers besides positions and velocities, which "
            "nobody measured; accepted are actuators without dynamics or delay (both are among "
            "the causes), and springs that do not yield"
        )
    commanded = [i for i in range(model.nu) if not is_added(model.actuator(i).name)]
    widths = {"qpos": model.nq, "qvel": model.nv, "ctrl": len(commanded)}
    for name, width in widths.items():
        if (given := getattr(data, name).shape[1]) != width:
            raise InvalidInput(f"{name} has {given} columns; the model has {width}")


def _steps(period: float, timestep: float) -> int:
    steps = period / timestep
    if round(steps) < 1 or abs(steps - round(steps)) > 1e-3 * steps:
        raise InvalidInput(
            f"rows are {period:g} s apart, which is no multiple of the model's step of "
            f"{timestep:g} s"
        )
    if steps > _MOST_STEPS:
        raise InvalidInput(
            f"rows are {period:g} s apart, {round(steps)} of the model's steps; accepted are "
            f"{_MOST_STEPS} at most (is `time` in seconds?)"
        )
    return round(steps)


def _threads(asked: int | None) -> int:
    cores = len(os.sched_getaffinity(0)) if asked is None else asked
    return 0 if cores == 1 else cores
