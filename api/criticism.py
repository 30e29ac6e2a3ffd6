"""`adr criticise`: from files to files, without a service."""

import json
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from adr_service.criticism.extension import Extension
from adr_service.criticism.measurements import Measurement
from adr_service.criticism.pipeline import Criticism, criticise
from adr_service.criticism.report import report_page
from adr_service.criticism.simulator import Nominal
from adr_service.errors import InvalidInput
from adr_service.parameters import Parameter, ParameterSpace
from adr_service.progress import Progress
from adr_service.tasks.catalogue import get_task, source_of


def nominal_of(
    task: str | None, variant: str, model: Path | None, free: Sequence[str]
) -> tuple[Nominal, str]:
    """What is criticised, and its name. Raises InvalidInput where it is not one thing."""
    if (task is None) == (model is None):
        raise InvalidInput("give either --task or --model")
    if task is not None:
        if free:
            raise InvalidInput("--free goes with --model; a task has its own parameters")
        return Nominal.of_task(get_task(task), source_of(task, variant)), f"{task}, {variant}"
    assert model is not None
    try:
        xml = model.read_text()
    except OSError as error:
        raise InvalidInput(f"{model} cannot be read: {error}") from error
    space = ParameterSpace(tuple(_parameter(text) for text in free))
    return Nominal.of_model(xml, space), model.name


def _parameter(text: str) -> Parameter:
    """ADDRESS=LOW:HIGH."""
    address, _, bounds = text.partition("=")
    low, _, high = bounds.partition(":")
    try:
        return Parameter(address, address, "SI", float(low), float(high), float(low))
    except ValueError as error:
        raise InvalidInput(
            f"--free {text!r} is not ADDRESS=LOW:HIGH, as in body:thigh.mass=1:5"
        ) from error


def criticise_files(
    nominal: Nominal, name: str, data: Path, out: Path, seed: int, progress: Progress
) -> Criticism:
    """Writes verdict.json, report.html and, where something was named, the extended model."""
    try:
        content = data.read_bytes()
    except OSError as error:
        raise InvalidInput(f"{data} cannot be read: {error}") from error
    measurement = Measurement.from_npz(content)
    found = criticise(nominal, measurement, np.random.default_rng(seed), progress)
    out.mkdir(parents=True, exist_ok=True)
    (out / "verdict.json").write_text(json.dumps(found.verdict.to_json(), indent=1))
    (out / "report.html").write_text(report_page(found, name))
    if found.extension is not None:
        write_extension(found.extension, out)
    return found


def write_extension(extension: Extension, out: Path) -> None:
    (out / "extended.xml").write_text(extension.xml)
    if extension.causes:
        (out / "extended.json").write_text(json.dumps(extension.sidecar, indent=1))
