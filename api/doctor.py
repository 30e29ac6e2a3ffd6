"""What the service needs on a machine, checked."""

import importlib.util
import os
import resource
import shutil
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path

from rich.console import Console
from rich.markup import escape

from adr_service.errors import InvalidInput
from adr_service.simulation.model import compiled
from adr_service.simulation.rendering import Camera
from adr_service.tasks.catalogue import catalogue
from adr_service.tasks.check import check_task
from api.connections import connections_allowed
from api.settings import read_settings

_LEAST_DISK_GB = 2.0
_LEAST_FILES = 1024


def check(console: Console) -> int:
    """Print each check with its remedy; 0 if nothing needed is missing."""
    checks: list[Callable[[], tuple[bool, str]]] = [
        _python,
        _cores,
        _simulator,
        _fast_backend,
        _drawing,
        _disk,
        _descriptors,
        _settings,
        _datasets,
    ]
    needed = True
    for run in checks:
        good, text = run()
        optional = run in (_fast_backend, _drawing, _datasets)
        mark = (
            "[green]ok[/green]  "
            if good
            else "[yellow]note[/yellow]"
            if optional
            else "[red]no[/red]  "
        )
        console.print(f"{mark} {escape(text)}", highlight=False)
        needed = needed and (good or optional)
    return 0 if needed else 1


def _python() -> tuple[bool, str]:
    found = ".".join(map(str, sys.version_info[:3]))
    return sys.version_info >= (3, 11), f"Python {found}; 3.11 or later is needed"


def _cores() -> tuple[bool, str]:
    count = len(os.sched_getaffinity(0))
    return count >= 1, f"{count} cores: as many policies are trained at once"


def _simulator() -> tuple[bool, str]:
    try:
        for entry in catalogue().values():
            check_task(entry)
    except InvalidInput as error:
        return False, str(error)
    return True, f"MuJoCo simulates the tasks: {', '.join(catalogue())}"


def _fast_backend() -> tuple[bool, str]:
    if importlib.util.find_spec("sbx") is not None:
        return True, "sbx-rl is installed: policies train several times faster than with SB3"
    return False, "sbx-rl is not installed; pip install 'adr-service[fast]' trains much faster"


def _drawing() -> tuple[bool, str]:
    try:
        Camera(compiled(next(iter(catalogue().values())).task.xml)).close()
    except InvalidInput as error:
        return False, f"no films: {error}"
    return True, "films can be drawn"


def _disk() -> tuple[bool, str]:
    free = shutil.disk_usage(tempfile.gettempdir()).free / 1e9
    return (
        free >= _LEAST_DISK_GB,
        f"{free:.0f} GB free where Ray works; {_LEAST_DISK_GB:.0f} needed",
    )


def _descriptors() -> tuple[bool, str]:
    _, most = resource.getrlimit(resource.RLIMIT_NOFILE)
    try:
        given = read_settings().max_connections
    except InvalidInput:
        given = None  # the check of settings says what is wrong
    files = "any number of" if most == resource.RLIM_INFINITY else f"{most:,}"
    return (
        most == resource.RLIM_INFINITY or most >= _LEAST_FILES,
        f"{files} files and connections may be open (ulimit -Hn); {_LEAST_FILES:,} needed: "
        f"{connections_allowed(given):,} connections at once, the rest for Ray and the database",
    )


def _settings() -> tuple[bool, str]:
    try:
        settings = read_settings()
    except InvalidInput as error:
        return False, f"the ADR_… settings are not valid: {error}"
    return (
        True,
        f"data in {settings.data_dir.absolute()}, service at {settings.host}:{settings.port}",
    )


def _datasets() -> tuple[bool, str]:
    folder = os.environ.get("ADR_DATASETS", "")
    if folder and Path(folder).is_dir():
        return True, f"published data sets in {folder}"
    return False, "ADR_DATASETS names no folder: tests on published data will be skipped"
