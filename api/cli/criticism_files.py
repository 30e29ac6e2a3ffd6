"""A criticism from files to files, without a service."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from adr_service.arrays import Vector
from adr_service.criticism.extension import written_out
from adr_service.criticism.measurements import Measurement
from adr_service.criticism.next_recording import Separation, next_recording, recorded_limits
from adr_service.criticism.nominal import Nominal
from adr_service.criticism.pipeline import Criticism, criticise
from adr_service.criticism.report import FILES, files_of
from adr_service.errors import InvalidInput, UnknownName
from adr_service.parameters import Parameter, ParameterSpace
from adr_service.progress import Progress
from adr_service.tasks.catalogue import get_task, variant_of


def nominal_of(
    task: str | None, variant: str | None, model: Path | None, free: Sequence[str]
) -> tuple[Nominal, str]:
    """Return the simulator to criticise, and its name.

    Raises InvalidInput unless the options name exactly one.
    """
    if (task is None) == (model is None):
        raise InvalidInput("give either --task or --model")
    if task is None:
        assert model is not None
        if variant is not None:
            raise InvalidInput("--variant goes with --task")
        return _nominal_of_model(model, free)
    if free:
        raise InvalidInput("--free goes with --model; a task has its own parameters")
    chosen = variant or "vanilla"
    return Nominal.of_task(get_task(task), variant_of(task, chosen).source), f"{task}, {chosen}"


def _nominal_of_model(model: Path, free: Sequence[str]) -> tuple[Nominal, str]:
    space = ParameterSpace(tuple(_parameter(text) for text in free))
    if not model.is_file():
        raise InvalidInput(f"{model} cannot be read: it is no file")
    try:
        files: Any = mujoco.MjSpec  # whose stub lacks `from_file`
        xml = written_out(files.from_file(str(model)))  # with everything that it includes
    except ValueError as error:
        raise InvalidInput(f"MuJoCo cannot read {model}: {error}") from error
    return Nominal.of_model(xml, space, folder=str(model.parent.absolute())), model.name


def _parameter(text: str) -> Parameter:
    """Return the parameter of a text ADDRESS=LOW:HIGH."""
    address, _, bounds = text.partition("=")
    low, _, high = bounds.partition(":")
    try:
        return Parameter(address, address, "SI", float(low), float(high), float(low))
    except ValueError as error:
        raise InvalidInput(
            f"--free {text!r} is not ADDRESS=LOW:HIGH, as in body:thigh.mass=1:5"
        ) from error


def criticise_files(
    nominal: Nominal, name: str, data: Sequence[Path], out: Path, seed: int, progress: Progress
) -> Criticism:
    """Write verdict.json, report.html and, if effects are named, the extended model."""
    whole = Measurement.joined([_measurement(path) for path in data])
    criticism = criticise(nominal, whole, np.random.default_rng(seed), progress)
    write(out, files_of(criticism, name))
    return criticism


def plan_file(
    criticism: Criticism, out: Path, limits: Sequence[tuple[int, float, float]], seed: int
) -> list[str]:
    """Write the commands of the next recording, and return what to expect of it."""
    simulator = criticism.final.simulator
    allowed = recorded_limits(simulator)
    for number, low, high in limits:
        allowed[number] = low, high
    plan = next_recording(criticism, allowed, np.random.default_rng(seed))
    out.parent.mkdir(parents=True, exist_ok=True)
    out.write_bytes(plan.to_npz())
    episodes, rows, _ = plan.commands.shape
    lines = [f"{out}: commands of {episodes} episodes, {rows * plan.period:.2g} s each"]
    for each in plan.separations:
        lines.append(f"  {each.named} or {each.other}: {_expected(each)}")
    joints = [simulator.base.joint(i).name for i in range(simulator.base.njnt)]
    for name, now, before in zip(joints, plan.reach, plan.recorded, strict=True):
        lines.append(f"  {name}: {_range(now)} in simulation, {_range(before)} as recorded")
    return lines


def _range(bounds: Vector) -> str:
    return f"{bounds[0]:.3g} to {bounds[1]:.3g}"


def _expected(each: Separation) -> str:
    if not each.is_expected:
        return "no commands that we tried tell these apart"
    return (
        f"{each.if_named:.0f} nats are expected if it is the first, {each.if_other:.0f} if it is "
        "the second"
    )


def limit_of(text: str, nominal: Nominal) -> tuple[int, float, float]:
    """The actuator's number and the limits of a text NAME=LOW:HIGH."""
    name, _, bounds = text.partition("=")
    low, _, high = bounds.partition(":")
    model = nominal.model(nominal.start)
    names = [model.actuator(i).name for i in range(model.nu)]
    if name not in names:
        raise UnknownName("actuator", name, names)
    try:
        return names.index(name), float(low), float(high)
    except ValueError as error:
        raise InvalidInput(
            f"--limit {text!r} is not NAME=LOW:HIGH, as in motor=-0.5:0.5"
        ) from error


def write(out: Path, files: Mapping[str, bytes]) -> None:
    """Write the files of a criticism, and delete those of an earlier one."""
    out.mkdir(parents=True, exist_ok=True)
    for name in FILES:
        (out / name).unlink(missing_ok=True)
        if name in files:
            (out / name).write_bytes(files[name])


def _measurement(path: Path) -> Measurement:
    try:
        if path.suffix == ".csv":
            return Measurement.from_csv(path.read_text())
        return Measurement.from_npz(path.read_bytes())
    except (OSError, UnicodeDecodeError) as error:
        raise InvalidInput(f"{path} cannot be read: {error}") from error
