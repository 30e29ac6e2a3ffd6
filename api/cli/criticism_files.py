"""A criticism from files to files, without a service."""

import filecmp
import os
import re
from collections import Counter, defaultdict
from collections.abc import Generator, Mapping, Sequence
from contextlib import contextmanager, suppress
from datetime import datetime
from pathlib import Path
from typing import Any, TypeVar

import mujoco
import numpy as np

from adr_service.arrays import Vector
from adr_service.criticism.compatibility import commanded_actuators, joints_of
from adr_service.criticism.csv_tables import measurement_from_csv
from adr_service.criticism.extension import written_out
from adr_service.criticism.measurements import Measurement, is_measurement
from adr_service.criticism.next_recording import (
    check_limits,
    next_recording,
    recorded_limits,
)
from adr_service.criticism.nominal import Nominal
from adr_service.criticism.overlaps import check_apart
from adr_service.criticism.pipeline import Criticism, criticise
from adr_service.criticism.plans import Plan, Separation
from adr_service.criticism.recordings import read_measurement
from adr_service.criticism.report import EXTENDED, FILES, files_of
from adr_service.errors import InvalidInput, UnknownName
from adr_service.json_values import encodable
from adr_service.logs.catalogue import ROWS_IN_FOLDERS
from adr_service.logs.mapping import is_slide
from adr_service.parameters import Parameter, ParameterSpace
from adr_service.progress import Progress
from adr_service.simulation.model import not_a_model, unit_at
from adr_service.tasks.base import Task
from adr_service.tasks.catalogue import get_task, variant_of
from adr_service.whole_files import written_whole
from api.cli.files import check_writable, naming, read, read_text

_ROUNDED = 1e-3  # of a joint's range, to which messages round it
T = TypeVar("T")
Bounds = Mapping[int, tuple[float, float]]  # by number of an actuator or a joint
Pose = Mapping[int, float]  # positions [rad or m] by number of a joint


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
    if not model.is_file():
        raise InvalidInput(f"{model} cannot be read: it is no file")
    try:
        files: Any = mujoco.MjSpec  # whose stub lacks `from_file`
        xml = written_out(files.from_file(str(model)))  # with everything that it includes
    except ValueError as error:
        raise not_a_model(str(model), error) from error
    folder = str(model.parent.absolute())
    with naming(model):
        bare = Nominal.of_model(xml, ParameterSpace(()), folder=folder)
    space = ParameterSpace(tuple(_parameter(text, bare) for text in free))
    return Nominal.of_model(xml, space, folder=folder), encodable(model.name)


def _parameter(text: str, nominal: Nominal) -> Parameter:
    """Return the parameter of a text ADDRESS=LOW:HIGH, in the unit that it has in the model."""
    address, _, bounds = text.rpartition("=")
    low, _, high = bounds.partition(":")
    try:
        given = float(low), float(high)
    except ValueError as error:
        raise InvalidInput(
            f"--free {text!r} is not ADDRESS=LOW:HIGH, as in body:thigh.mass=1:5"
        ) from error
    if not given[0] < given[1] or not np.isfinite(given).all():
        raise InvalidInput(
            f"--free {text!r} needs finite bounds, the lower one first, as in body:thigh.mass=1:5"
        )
    unit = unit_at(nominal.model(nominal.start), address)
    return Parameter(address, address, unit, *given, given[0])


def criticise_files(
    nominal: Nominal, name: str, data: Sequence[Path], out: Path, seed: int, progress: Progress
) -> Criticism:
    """Write verdict.json, report.html and, if effects are named, the extended model."""
    check_differ(data)
    parts = [_measurement(path, nominal.task) for path in data]
    whole = Measurement.joined(parts)
    names = [encodable(path.name) for path in data]
    check_apart(names, parts)
    criticism = criticise(nominal, whole, np.random.default_rng(seed), progress)
    made = f"{datetime.now().astimezone():%Y-%m-%d}"
    files = files_of(criticism, name, f"{', '.join(names)}, seed {seed}, {made}")
    if EXTENDED in files:
        files[EXTENDED] = portable(files[EXTENDED].decode(), out).encode()
    write(out, files)
    return criticism


def check_differ(recordings: Sequence[Path]) -> None:
    """Raise InvalidInput for a recording that is given twice, which would count twice.

    Of folders, the files are compared that hold rows.
    """
    earlier: dict[int, list[Path]] = defaultdict(list)  # files of those before, by size
    for recording in recordings:
        files = [(file, file.stat().st_size) for file in _files_of(recording) if file.exists()]
        for file, size in files:
            for other in earlier[size]:
                if other.samefile(file):
                    told = f"{other} and {file} are the same"
                    raise InvalidInput(f"{told}; give each recording once")
                if _is_copy(other, file):
                    told = f"{other} and {file} have the same content"
                    raise InvalidInput(f"{told}; give each recording once")
        for file, size in files:  # those of one folder may be alike
            earlier[size].append(file)


def _files_of(recording: Path) -> list[Path]:
    if not recording.is_dir():
        return [recording]
    return [file for pattern in ROWS_IN_FOLDERS for file in sorted(recording.glob(pattern))]


def _is_copy(one: Path, other: Path) -> bool:
    try:
        return filecmp.cmp(one, other, shallow=False)
    except OSError:  # whoever reads it will say so
        return False


def portable(xml: str, folder: Path) -> str:
    """MJCF for a folder whose meshes and textures are found by paths relative to that."""

    def relative(found: re.Match[str]) -> str:
        return f'{found[1]}="{Path(os.path.relpath(found[2], folder)).as_posix()}"'

    return re.sub(r'\b(meshdir|texturedir)="(/[^"]*)"', relative, xml)


def plan_file(
    criticism: Criticism, out: Path, limits: Bounds, allowed: Bounds, start: Pose, seed: int
) -> list[str]:
    """Write the commands of the next recording, and return what to expect of it."""
    simulator = criticism.final.simulator
    commands = recorded_limits(simulator)
    for number, bounds in limits.items():
        commands[number] = bounds
    rng = np.random.default_rng(seed)
    plan = next_recording(criticism, commands, rng, allowed=allowed, start=start or None)
    out.parent.mkdir(parents=True, exist_ok=True)
    with written_whole(out) as part:
        part.write_bytes(plan.to_npz())
    episodes, rows, _ = plan.commands.shape
    lines = [f"{out}: commands of {episodes} episodes, {rows * plan.period:.2g} s each"]
    for each in plan.separations:
        lines.append(f"  {each.named} or {each.other}: {_expected(each)}")
    if not plan.separations:
        shown = ", ".join(plan.newly_shown)
        lines.append(
            f"  nothing is tied; it could show what the recording cannot: {shown}"
            if shown
            else "  nothing is tied, and it could show nothing that the recording cannot"
        )
    joints = joints_of(simulator.base)
    lines.append(f"  each episode starts {_beginning(plan, joints)}")
    for name, now, before in zip(joints, plan.reach, plan.recorded, strict=True):
        unit = _unit(simulator.base, name)
        lines.append(f"  {name}: {_range(now)} {unit} in simulation, {_range(before)} as recorded")
    return lines


def _beginning(plan: Plan, joints: Sequence[str]) -> str:
    if plan.start is None:
        return "after a reset, as recorded ones do"
    at = ", ".join(f"{name} = {value:.3g}" for name, value in zip(joints, plan.start, strict=True))
    return f"at rest at {at}"


def _range(bounds: Vector) -> str:
    return f"{bounds[0]:.3g} to {bounds[1]:.3g}"


def _expected(each: Separation) -> str:
    if not each.is_expected:
        return "no commands that we tried tell these apart"
    return (
        f"{each.if_named:.0f} nats are expected if it is the first, {each.if_other:.0f} if it is "
        "the second"
    )


def limits_of(texts: Sequence[str], nominal: Nominal) -> Bounds:
    """Limits of commands of texts NAME=LOW:HIGH, by the actuator's number.

    Raises InvalidInput for a model that has none, and for limits that an actuator does not obey.
    """
    model = nominal.model(nominal.start)
    names = commanded_actuators(model)
    given = _once("limit", [_bounds("limit", "actuator", text, names) for text in texts], names)
    limits = model.actuator_ctrlrange[: len(names)].copy()
    for number, bounds in given.items():
        limits[number] = bounds
    check_limits(limits, model)
    return given


def reach_of(texts: Sequence[str], nominal: Nominal) -> Bounds:
    """Allowed positions [rad or m] of texts NAME=LOW:HIGH, by the joint's number.

    Raises InvalidInput for positions beyond the model's range of the joint.
    """
    model = nominal.model(nominal.start)
    names = joints_of(model)
    given = _once("reach", [_bounds("reach", "joint", text, names) for text in texts], names)
    for number, bounds in given.items():
        for position in bounds:
            _check_position("reach", names[number], position, model)
    return given


def start_of(texts: Sequence[str], nominal: Nominal) -> Pose:
    """Positions of texts NAME=VALUE, by the joint's number."""
    model = nominal.model(nominal.start)
    names = joints_of(model)
    pose: list[tuple[int, float]] = []
    for text in texts:
        name, _, value = text.partition("=")
        if name not in names:
            raise UnknownName("joint", name, names)
        try:
            position = float(value)
        except ValueError as error:
            raise InvalidInput(
                f"--start {text!r} is not NAME=POSITION, as in {names[0]}=0.5"
            ) from error
        if not np.isfinite(position):
            raise InvalidInput(f"--start {text!r} is not finite; needed is a position of {name}")
        _check_position("start", name, position, model)
        pose.append((names.index(name), position))
    return _once("start", pose, names)


def _check_position(option: str, name: str, position: float, model: mujoco.MjModel) -> None:
    """Raises InvalidInput for a position beyond a joint's range, to within its last digits."""
    joint = model.joint(name)
    low, high = joint.range
    slack = _ROUNDED * (high - low)
    if joint.limited[0] and not low - slack <= position <= high + slack:
        raise InvalidInput(
            f"--{option} {name}: given {position:g}; the joint may be at {low:.4g} to {high:.4g} "
            f"{_unit(model, name)}"
        )


def _unit(model: mujoco.MjModel, joint: str) -> str:
    return "m" if is_slide(model, joint) else "rad"


def _once(option: str, given: Sequence[tuple[int, T]], names: Sequence[str]) -> dict[int, T]:
    """The values by number. Raises InvalidInput if a number has two."""
    for number, count in Counter(number for number, _ in given).items():
        if count > 1:
            raise InvalidInput(f"--{option} has {names[number]} {count} times")
    return dict(given)


def _bounds(
    option: str, kind: str, text: str, names: Sequence[str]
) -> tuple[int, tuple[float, float]]:
    name, _, bounds = text.rpartition("=")
    low, _, high = bounds.partition(":")
    if name and name not in names:
        raise UnknownName(kind, name, names)
    try:
        given = float(low), float(high)
        number = names.index(name)
    except ValueError as error:
        example = next(iter(names), kind)
        raise InvalidInput(
            f"--{option} {text!r} is not NAME=LOW:HIGH, as in {example}=-0.5:0.5"
        ) from error
    if not given[0] <= given[1]:
        raise InvalidInput(f"--{option} {text!r}: the lower bound comes first")
    return number, given


@contextmanager
def output_folder(folder: Path) -> Generator[None]:
    """A folder for the files of a criticism. After an error a new one is gone, if it is empty.

    Raises InvalidInput unless all files can be written into it.
    """
    is_new = not folder.exists()
    check_writable(*(folder / name for name in FILES))
    try:
        yield
    except BaseException:
        if is_new:
            with suppress(OSError):
                folder.rmdir()
        raise


def write(out: Path, files: Mapping[str, bytes]) -> None:
    """Write the files of a criticism."""
    out.mkdir(parents=True, exist_ok=True)
    for name, content in files.items():
        with written_whole(out / name) as part:
            part.write_bytes(content)


def _measurement(path: Path, task: Task | None) -> Measurement:
    """The measurement in a file, or a task's recording as one."""
    content = read_text(path) if path.suffix.lower() == ".csv" else read(path)
    with naming(path):
        if isinstance(content, str):
            return measurement_from_csv(content)
        if task is not None:
            return read_measurement(task, content)
        if is_measurement(content):
            return Measurement.from_npz(content)
        raise InvalidInput(
            "it is no measurement of states and commands, which a --model needs "
            "(docs/criticism.md); adr measure makes one of a robot's log, and recordings of "
            "transitions go with a --task"
        )
