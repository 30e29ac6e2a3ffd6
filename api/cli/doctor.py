"""`adr doctor`: checks of everything that the service needs on a machine."""

import importlib.util
import os
import resource
import shutil
import sys
from collections.abc import Iterable, Iterator
from dataclasses import asdict, dataclass
from pathlib import Path

import typer
from rich.console import Console
from rich.text import Text

from adr_service.client import Refused, Unreachable, connect
from adr_service.errors import InvalidInput
from api.cli.options import AsJson, Url
from api.cli.single_options import SingleOptionApp
from api.cli.terminal import console
from api.settings import read_settings, too_many_cores, unknown_variables

app = SingleOptionApp()
_LEAST_DISK_GB = 2.0
_LEAST_FILES = 1024


@dataclass(frozen=True)
class Check:
    """Outcome of one check; `text` has the remedy."""

    is_good: bool
    text: str
    is_needed: bool = True  # else the service works without it

    @property
    def is_fine(self) -> bool:
        return self.is_good or not self.is_needed


@app.command()
def doctor(url: Url = None, as_json: AsJson = False) -> None:
    """Check what the service needs on this machine."""
    if as_json:
        found = list(checks(url))
        console.print_json(data=[asdict(check) for check in found])
        is_fit = all(check.is_fine for check in found)
    else:
        is_fit = report(console, checks(url))
    raise typer.Exit(0 if is_fit else 1)


def report(output: Console, results: Iterable[Check]) -> bool:
    """Print each check; True if nothing needed is missing."""
    is_fit = True
    for check in results:
        output.print(Text.assemble(_mark(check), f" {check.text}"))
        is_fit = is_fit and check.is_fine
    return is_fit


def _mark(check: Check) -> tuple[str, str]:
    """A word and its colour."""
    if check.is_good:
        return "ok  ", "green"
    return ("no  ", "red") if check.is_needed else ("note", "yellow")


def checks(url: str | None) -> Iterator[Check]:
    """Check the machine, the ADR_… settings, and the service at an address."""
    yield _python()
    yield _cores()
    yield from _simulator()
    yield _methods()
    yield _fast_backend(importlib.util.find_spec("sbx") is not None)
    for doubt in unknown_variables(os.environ):
        yield Check(False, doubt, is_needed=False)
    try:
        settings = read_settings()
        folders = sorted(settings.folders)
    except InvalidInput as error:
        yield Check(False, f"the ADR_… settings are not valid: {error}")
        settings = None
    else:
        at = f"service at {settings.host}:{settings.port}"
        yield Check(True, f"data in {settings.data_dir.absolute()}, {at}")
        for doubt in too_many_cores(settings):
            yield Check(False, doubt, is_needed=False)
        yield from (_disk(folder, settings.disk_floor_mb / 1000) for folder in folders)
    yield _descriptors(None if settings is None else settings.max_connections)
    yield _running(url)
    yield _datasets(os.environ.get("ADR_DATASETS", ""))


def _python() -> Check:
    version = ".".join(map(str, sys.version_info[:3]))
    return Check(sys.version_info >= (3, 11), f"Python {version}; 3.11 or later is needed")


def _cores() -> Check:
    count = len(os.sched_getaffinity(0))
    return Check(count >= 1, f"cores: {count}; each trains one policy at a time")


def _simulator() -> Iterator[Check]:
    from adr_service.simulation.model import compiled  # imports MuJoCo
    from adr_service.simulation.rendering import Camera
    from adr_service.tasks.catalogue import catalogue
    from adr_service.tasks.check import check_task

    try:
        for entry in catalogue().values():
            check_task(entry)
    except InvalidInput as error:
        yield Check(False, str(error))
        return
    yield Check(True, f"MuJoCo simulates the tasks: {', '.join(catalogue())}")
    try:
        Camera(compiled(next(iter(catalogue().values())).task.xml)).close()
    except InvalidInput as error:
        yield Check(False, f"no films: {error}", is_needed=False)
    else:
        yield Check(True, "films can be drawn", is_needed=False)


def _methods() -> Check:
    try:
        from adr_service.methods.catalogue import methods  # imports packages with plug-ins

        return Check(True, f"methods: {', '.join(methods())}")
    except InvalidInput as error:
        return Check(False, str(error))


def _fast_backend(is_installed: bool) -> Check:
    text = (
        "sbx-rl is installed: policies train several times faster than with SB3"
        if is_installed
        else "sbx-rl is not installed; pip install 'adr-service[fast]' trains much faster"
    )
    return Check(is_installed, text, is_needed=False)


def _disk(folder: Path, floor_gb: float) -> Check:
    """Check the disk of a folder that the service writes to, or will make.

    Below `floor_gb` the service refuses work.
    """
    needed = max(_LEAST_DISK_GB, floor_gb)
    there = next(path for path in (folder, *folder.parents) if path.exists())
    free = shutil.disk_usage(there).free / 1e9
    text = f"{free:.1f} GB free for {folder}; {needed:.3g} needed"
    return Check(free >= needed, text)


def _descriptors(max_connections: int | None) -> Check:
    from api.connections import connections_allowed  # imports uvicorn

    _, most = resource.getrlimit(resource.RLIMIT_NOFILE)
    is_unlimited = most == resource.RLIM_INFINITY
    files = "any number of" if is_unlimited else f"{most:,}"
    return Check(
        is_unlimited or most >= _LEAST_FILES,
        f"{files} files and connections may be open (ulimit -Hn); {_LEAST_FILES:,} needed: "
        f"{connections_allowed(max_connections):,} connections at once, the rest for Ray and the "
        "database",
    )


def _running(url: str | None) -> Check:
    try:
        with connect(url, timeout_s=5.0) as client:
            client.ready()
            return Check(True, f"a service answers at {client.url}", is_needed=False)
    except InvalidInput as error:
        return Check(False, str(error))
    except (Refused, Unreachable) as error:
        return Check(False, str(error), is_needed=False)


def _datasets(folder: str) -> Check:
    if folder and Path(folder).is_dir():
        return Check(True, f"published data sets in {folder}", is_needed=False)
    text = "ADR_DATASETS names no folder: tests on published data will be skipped"
    return Check(False, text, is_needed=False)
