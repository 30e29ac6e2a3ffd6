"""Upload recordings and measurements of a real machine, and list them."""

from pathlib import Path
from typing import Annotated

import typer
from rich.table import Table

from adr_service.client import Json, connect
from adr_service.errors import InvalidInput
from api.cli.files import read
from api.cli.options import AsJson, Url
from api.cli.single_options import SingleOptionApp
from api.cli.terminal import console

app = SingleOptionApp()
_MINARI = "minari"


@app.command()
def upload(
    file: Annotated[
        str, typer.Argument(help="An .npz, PREFIX of DROPO's PREFIX_*.npy, or minari:NAME.")
    ],
    task: Annotated[str, typer.Option(help="Task that was recorded: hopper, …")],
    url: Url = None,
    as_json: AsJson = False,
) -> None:
    """Store a recording or measurement of a real machine for later runs; print its id."""
    with connect(url) as client:
        stored = client.upload(_read(file, task), task, Path(file).name)
    if as_json:
        console.print_json(data=stored)
    else:
        console.print(stored["id"])


@app.command()
def datasets(url: Url = None, as_json: AsJson = False) -> None:
    """List uploaded recordings and measurements."""
    with connect(url) as client:
        stored = client.list_all("datasets")
    if as_json:
        console.print_json(data=stored)
        return
    none = "no recordings yet; `adr upload` stores one"
    console.print(_datasets_table(stored) if stored else none)


def _datasets_table(stored: list[Json]) -> Table:
    table = Table(box=None)
    table.add_column("id", no_wrap=True)
    for heading in ("transitions", "episodes", "period"):
        table.add_column(heading)
    table.add_column("origin", overflow="fold")
    for data in stored:
        counts = (str(data["transitions"]), str(data["episodes"]), f"{data['dt']:g} s")
        table.add_row(data["id"], *counts, data["origin"])
    return table


def _read(name: str, task_name: str) -> bytes:
    """Return the `.npz` of a recording in a file or a local data set of Minari."""
    kind, _, rest = name.partition(":")
    if kind != _MINARI:
        return read_recording(Path(name), task_name)
    from adr_service.interchange.minari_datasets import from_minari
    from adr_service.tasks.catalogue import get_task

    return from_minari(rest, get_task(task_name)).to_npz()


def read_recording(file: Path, task_name: str) -> bytes:
    """Return the `.npz` of a recording; DROPO's four `.npy` files become one.

    The `.npy` files have no control period and no columns: the task's are taken.
    """
    if not file.suffix or file.with_name(f"{file.name}_observations.npy").exists():
        return _combined(file, task_name)
    if file.suffix != ".npz":
        raise InvalidInput(
            f"a recording is an .npz, or a prefix of .npy files; given {file}. adr measure makes a "
            "measurement of a robot's log"
        )
    return read(file)


def _combined(prefix: Path, task_name: str) -> bytes:
    # the simulator takes a moment to import, and only this needs it
    from adr_service.simulation.batch import control_period
    from adr_service.tasks.catalogue import get_task
    from adr_service.transitions import TransitionDataset

    task = get_task(task_name)
    return TransitionDataset.from_npy(
        prefix,
        dt=control_period(task),
        columns=task.columns[: task.measured],
        origin=f"{prefix.name}_*.npy",
    ).to_npz()
