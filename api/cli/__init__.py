"""The command line, `adr`: it starts the service, or is its client.

Each file has one family of commands. A command imports what takes seconds (Ray, MuJoCo, PyTorch)
when it runs, so that `adr --help` answers at once.
"""

import io
import sys
from importlib.metadata import version
from typing import Annotated

import typer
from rich.text import Text

import adr_service
from adr_service.client import Refused
from adr_service.errors import AdrError
from api.cli import (
    archive,
    criticise,
    criticise_bench,
    data,
    demo,
    doctor,
    export,
    measure,
    render,
    results,
    robot,
    runs,
    serve,
    tune,
    upkeep,
)
from api.cli.single_options import SingleOptionApp
from api.cli.terminal import console, errors

_FAILED, _USAGE, _NOT_FOUND, _REFUSED, _UNREACHABLE = 1, 2, 3, 4, 5
_STATUS = {  # by an error's code
    **dict.fromkeys(("not_verified", "damaged", "service_did_not_start", "robot_failed"), _FAILED),
    "not_found": _NOT_FOUND,
    "unreachable": _UNREACHABLE,
}
_BY_ANSWER = {404: _NOT_FOUND, 422: _USAGE}  # by the service's refusal; others are refused
_BESIDE = ("mujoco", "ray", "torch", "stable-baselines3")  # whose versions change numbers

app = SingleOptionApp(
    help="Benchmark adaptive domain randomization.",
    epilog=(
        "Exit status: 0 done; 1 something that was watched or checked failed, a robot did, or the "
        "service could not start or go on; 2 wrong use or input; 3 not found; 4 refused by the "
        "service; 5 no service answers. "
        "ADR_URL, or ADR_PORT on this machine, names the service to ask."
    ),
    no_args_is_help=True,
)
for family in (serve, runs, results, data, measure, criticise, tune, render, robot, demo, doctor):
    app.add_typer(family.app)
app.add_typer(archive.app, name="archive")
app.add_typer(export.app, name="export")
app.add_typer(criticise_bench.app, name="criticise-bench")
app.add_typer(upkeep.app, name="db")


def _show_versions(asked: bool) -> None:
    if asked:
        console.print(f"adr-service {adr_service.__version__}", highlight=False)
        for name in _BESIDE:
            console.print(f"{name} {version(name)}", highlight=False)
        raise typer.Exit


@app.callback()
def common(
    versions: Annotated[
        bool,
        typer.Option(
            "--version", callback=_show_versions, is_eager=True, help="Show versions, and end."
        ),
    ] = False,
) -> None:
    """Options without a command."""


def main() -> None:
    """Run the console script; expected errors become messages instead of tracebacks."""
    if isinstance(sys.stdout, io.TextIOWrapper):  # names of files may be no UTF-8
        sys.stdout.reconfigure(errors="backslashreplace")
    try:
        app()
    except (AdrError, OSError) as error:
        errors.print(Text.assemble(("error:", "red"), f" {_told(error)}"), soft_wrap=True)
        raise SystemExit(status_of(error)) from error


def _told(error: AdrError | OSError) -> str:
    """The message; of a file that the system refuses, its name and the reason without a number."""
    if isinstance(error, OSError) and error.filename is not None and error.strerror:
        return f"{error.filename}: {error.strerror.lower()}"
    return str(error)


def status_of(error: AdrError | OSError) -> int:
    """The exit status that the epilog explains."""
    if isinstance(error, Refused):
        return _BY_ANSWER.get(error.status, _REFUSED)
    return _STATUS.get(error.code, _USAGE) if isinstance(error, AdrError) else _USAGE
