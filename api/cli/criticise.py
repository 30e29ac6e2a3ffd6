"""`adr criticise`: name what a simulator gets wrong, given measured data."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import typer

from adr_service.client import Json, connect
from adr_service.errors import InvalidInput
from api.cli.files import check_writable
from api.cli.follow import must_have_succeeded, show_results
from api.cli.options import AsJson, Url, is_url_given
from api.cli.progress import live
from api.cli.single_options import SingleOptionApp
from api.cli.steps import progress_on
from api.cli.terminal import console, errors
from api.cli.verdict_table import verdict_table

app = SingleOptionApp()

Out = Annotated[Path, typer.Option(help="Folder for verdict, report and extended model.")]
Data = Annotated[
    list[Path] | None,
    typer.Option(
        help="A measurement, .npz or .csv, or a --task's recording; several are judged together."
    ),
]
Dataset = Annotated[
    str | None, typer.Option(help="Or an uploaded one, that the service criticises with.")
]
Task = Annotated[str | None, typer.Option(help="Criticise a task's simulator: arm, hopper, …")]
Variant = Annotated[str | None, typer.Option(help="Variant of the task: vanilla, …")]
Model = Annotated[Path | None, typer.Option(help="Or your own MJCF, a file you trust.")]
Free = Annotated[
    list[str] | None,
    typer.Option(help="Parameter of --model to fit, and its bounds: body:thigh.mass=1:5, …"),
]
Seed = Annotated[int, typer.Option(help="Seed of the bootstraps.", min=0)]
Next = Annotated[
    Path | None,
    typer.Option("--next", help="Write the commands of the recording to make next, .npz."),
]
Limit = Annotated[
    list[str] | None,
    typer.Option(help="Limits of its commands: motor=-0.5:0.5, …; else as recorded."),
]
Reach = Annotated[
    list[str] | None,
    typer.Option(help="Positions its joints may take: shoulder=-1:2, …; else near those recorded."),
]
Start = Annotated[
    list[str] | None,
    typer.Option(help="Where each episode starts at rest: shoulder=0.5, …; else as recorded."),
]


@dataclass(frozen=True)
class _Planned:
    """The recording to plan after a criticism."""

    file: Path
    limit: list[str]
    reach: list[str]
    start: list[str]


@app.command()
def criticise(
    ctx: typer.Context,
    out: Out,
    data: Data = None,
    dataset: Dataset = None,
    task: Task = None,
    variant: Variant = None,
    model: Model = None,
    free: Free = None,
    seed: Seed = 0,
    next_: Next = None,
    limit: Limit = None,
    reach: Reach = None,
    start: Start = None,
    url: Url = None,
    as_json: AsJson = False,
) -> None:
    """Name what a simulator gets wrong, given measured data; with --data, without a service."""
    if (not data) == (dataset is None):
        raise InvalidInput("give either --data or --dataset")
    if out.exists() and not out.is_dir():
        raise InvalidInput(f"{out} is a file; --out is a folder")
    if (limit or reach or start) and next_ is None:
        raise InvalidInput("--limit, --reach and --start go with --next")
    if data:
        if is_url_given(ctx):
            raise InvalidInput("--data is criticised here; --url goes with --dataset")
        given = (task, variant, model, free or [])
        planned = _Planned(next_, limit or [], reach or [], start or []) if next_ else None
        _criticise_here(data, out, given, seed, planned, as_json)
        return
    if next_ is not None:
        raise InvalidInput("--next goes with --data")
    if task is None or model is not None or free:
        raise InvalidInput("--dataset goes with --task; the service takes no --model or --free")
    spec = {"task": task, "variant": variant or "vanilla", "dataset": dataset, "seed": seed}
    _criticise_there(spec, out, url, as_json)


def _criticise_here(
    data: list[Path],
    out: Path,
    given: tuple[str | None, str | None, Path | None, list[str]],
    seed: int,
    planned: _Planned | None,
    as_json: bool,
) -> None:
    """Criticise in this process; `given` is task, variant, model and free parameters."""
    from api.cli import criticism_files  # imports the simulator

    if planned is not None:
        _check_apart(planned.file, out, criticism_files.FILES)
    nominal, name = criticism_files.nominal_of(*given)
    limits, allowed, start = {}, {}, {}
    with criticism_files.output_folder(out):
        if planned is not None:  # wrong ones are refused before the work
            check_writable(planned.file)
            limits = criticism_files.limits_of(planned.limit, nominal)
            allowed = criticism_files.reach_of(planned.reach, nominal)
            start = criticism_files.start_of(planned.start, nominal)
        with progress_on(errors) as progress:
            criticism = criticism_files.criticise_files(nominal, name, data, out, seed, progress)
    verdict, told = criticism.verdict.to_json(), errors if as_json else console
    if as_json:
        console.print_json(data=verdict)
    else:
        console.print(verdict_table(verdict))
    files = criticism_files.FILES[: 4 if criticism.extension else 2]
    told.print(f"{out}: {', '.join(files)}")
    if planned is not None:
        with told.status("planning"):
            lines = criticism_files.plan_file(criticism, planned.file, limits, allowed, start, seed)
        told.print("\n".join(lines), highlight=False)


def _check_apart(plan: Path, out: Path, names: Sequence[str]) -> None:
    """Raise InvalidInput if a plan would take the place of the folder of a criticism, or of one of
    its files."""
    file, folder = plan.resolve(), out.resolve()
    files = [folder / name for name in names]
    if file in (folder, *folder.parents) or any(each in (file, *file.parents) for each in files):
        raise InvalidInput(
            f"--next {plan} and --out {out} exclude each other: the folder gets "
            f"{', '.join(names)}; give --next a file beside these, as {out / 'next.npz'}"
        )


def _criticise_there(spec: Json, out: Path, url: str | None, as_json: bool) -> None:
    """Submit a criticism, follow it to its end, and write its files."""
    from api.cli import criticism_files  # imports the simulator

    told = errors if as_json else console
    with criticism_files.output_folder(out), connect(url) as client:
        id = client.submit_criticism(spec)["run"]["id"]
        told.print(id, highlight=False)
        final = live(told, client, id)
        if not as_json:
            show_results(client, final)
        must_have_succeeded(final)
        found = client.criticism(id)
        names = [name for name in criticism_files.FILES if name in found["links"]]
        criticism_files.write(out, {name: client.criticism_file(id, name) for name in names})
    if as_json:
        console.print_json(data=found["verdict"])
    told.print(f"{out}: {', '.join(names)}")
