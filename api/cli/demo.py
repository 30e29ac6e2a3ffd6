"""`adr demo`: the whole service, from nothing to a figure, on the small task."""

from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console

from adr_service.client import AdrClient, Json
from api.cli.options import AsJson
from api.cli.own_service import own_service
from api.cli.ports import free_port
from api.cli.progress import live
from api.cli.signals import end_as_by_ctrl_c
from api.cli.single_options import SingleOptionApp
from api.cli.tables import results_table
from api.cli.terminal import console, errors
from api.settings import read_settings

app = SingleOptionApp()
BENCHMARK = {
    "tasks": ["arm"],
    "methods": ["udr", "simopt", "dropo"],
    "seeds": [0, 1, 2],
    "preset": "demo",
}
_STORY = (
    "An arm must lift its hand to a mark. How heavy its links are and how much its joints "
    "rub is unknown;\nmethods infer that from trajectories of the target, and policies are "
    "trained on what they infer.\n"
)


@app.command()
def demo(
    data_dir: Annotated[Path, typer.Option(help="Folder for results.")] = Path("data/demo"),
    port: Annotated[int, typer.Option(help="0: any free port.", min=0, max=65535)] = 0,
    as_json: AsJson = False,
) -> None:
    """Run a small benchmark from nothing to its figures, in minutes."""
    end_as_by_ctrl_c()  # which ends the service as well
    shown = errors if as_json else console
    results = show(shown, data_dir, port or free_port())
    if as_json and results is not None:
        console.print_json(data=results)
    raise typer.Exit(0 if results is not None else 1)


def show(output: Console, data_dir: Path, port: int) -> Json | None:
    """Run `BENCHMARK` over REST on a service of its own; its results if all runs succeeded."""
    later = read_settings().port  # of `adr serve`
    output.print(f"Starting the service on http://127.0.0.1:{port} (data in {data_dir}) …")
    with own_service(data_dir, port) as client:
        benchmark = client.submit_benchmark(BENCHMARK)
        page = benchmark["links"]["page"]
        output.print(f"Watch it in a browser: {client.url}{page}")
        output.print(_STORY)
        final = live(output, client, benchmark["id"])
        results = client.results(benchmark["id"])
        output.print(results_table(results))
        if not _all_succeeded(output, final):
            return None
        _write_files(output, client, benchmark["id"], data_dir)
    output.print(
        f"The results stay in {data_dir}. To look at them again: adr serve --data-dir {data_dir}, "
        f"then http://127.0.0.1:{later}{page}"
    )
    return results


def _all_succeeded(output: Console, final: Json) -> bool:
    """Print why runs failed, if some did."""
    failed = [run for run in final["runs"] if run["state"] != "succeeded"]
    for run in failed:
        why = run["error"]["message"] if run["error"] else run["state"]
        output.print(f"{run['spec']['method']['name']} did not succeed: {why}")
    return not failed


def _write_files(output: Console, client: AdrClient, id: str, folder: Path) -> None:
    for name in ("returns.png", "parameters.png"):
        figure = folder / name
        figure.write_bytes(client.figure(id, name))
        output.print(f"figure: {figure}")
    (folder / "results.csv").write_text(client.results_csv(id), encoding="utf-8")
    output.print(f"table:  {folder / 'results.csv'}")
