"""The command line, `adr`: it starts the service, or is its client.

Each file has one family of commands. A command imports what takes seconds (Ray, MuJoCo, PyTorch)
when it runs, so that `adr --help` answers at once.
"""

import typer
from rich.markup import escape

from adr_service.errors import AdrError
from api.cli import (
    archive,
    criticise,
    criticise_bench,
    data,
    demo,
    doctor,
    measure,
    render,
    results,
    robot,
    runs,
    serve,
    tune,
    upkeep,
)
from api.cli.terminal import errors

app = typer.Typer(
    help="Benchmark adaptive domain randomization.", no_args_is_help=True, add_completion=False
)
for family in (serve, runs, results, data, measure, criticise, tune, render, robot, demo, doctor):
    app.add_typer(family.app)
app.add_typer(archive.app, name="archive")
app.add_typer(criticise_bench.app, name="criticise-bench")
app.add_typer(upkeep.app, name="db")


def main() -> None:
    """Run the console script; expected errors become messages instead of tracebacks."""
    try:
        app()
    except (AdrError, OSError) as error:
        errors.print(f"[red]error:[/red] {escape(str(error))}", highlight=False, soft_wrap=True)
        raise SystemExit(2) from error
