"""`adr measure`: make a measurement of robots' logs."""

from pathlib import Path
from typing import Annotated

import typer
from rich.text import Text

from adr_service.errors import InvalidInput
from api.cli.files import check_writable
from api.cli.single_options import SingleOptionApp
from api.cli.terminal import console

app = SingleOptionApp()

Logs = Annotated[
    list[Path],
    typer.Argument(help="CSV, NPZ, Parquet, MCAP, a LeRobot data set; one or several recordings."),
]
Task = Annotated[str | None, typer.Option(help="The robot is a task's: arm, hopper, …")]
Model = Annotated[Path | None, typer.Option(help="Or your own MJCF, a file you trust.")]
Map = Annotated[
    Path | None,
    typer.Option(help="TOML: which column is which joint; without it, a draft is printed."),
]
Out = Annotated[
    Path | None, typer.Option(help="The measurement, .npz; a page about it goes beside it, .html.")
]


@app.command()
def measure(
    logs: Logs, task: Task = None, model: Model = None, map: Map = None, out: Out = None
) -> None:
    """Convert robots' logs to a measurement for `adr criticise`; without a service."""
    from api.cli import measured_files  # imports the simulator

    if (map is None) != (out is None):
        raise InvalidInput("give --map and --out, or neither to see a draft of the map")
    if map is None or out is None:
        typer.echo(measured_files.draft_of(logs, task, model), nl=False)
        return
    if out.suffix != ".npz":
        raise InvalidInput(f"--out is a file that ends on .npz; given {out}")
    check_writable(out, out.with_suffix(".html"))
    with console.status("reading"):
        converted = measured_files.measure_files(logs, task, model, map, out)
    data = converted.measurement
    console.print(
        f"{out}: {len(data.spans())} episodes, {len(data.time)} rows, "
        f"{1000 * converted.period:g} ms apart",
        highlight=False,
    )
    console.print(f"{out.with_suffix('.html')}: what was read, and what the data could show")
    for warning in converted.warnings:
        console.print(Text.assemble(("look at this:", "yellow"), f" {warning}"))
