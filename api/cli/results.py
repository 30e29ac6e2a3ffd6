"""Tables and figures of results, files, papers to cite, and the claims of the paper."""

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import typer

from adr_service.client import AdrClient, connect
from adr_service.errors import InvalidInput
from adr_service.whole_files import written_whole
from api.cli.files import check_absent, check_new
from api.cli.follow import is_criticism, show_results
from api.cli.options import AsJson, Id, Url
from api.cli.single_options import SingleOptionApp
from api.cli.tables import claims_table, comparisons_table, cost_table
from api.cli.terminal import console

app = SingleOptionApp()
_KINDS = (".svg", ".png", ".csv")  # of figures
_OF_RUNS = ("--figure", "--figures", "--distribution", "--policy", "--compare", "--csv")

AsCsv = Annotated[bool, typer.Option("--csv", help="As CSV.")]
Figure = Annotated[
    Path | None, typer.Option(help="Write a figure: returns.svg, parameters.png, cost.csv, …")
]
Figures = Annotated[
    Path | None, typer.Option(help="Write all figures into this folder, as SVG, PNG and CSV.")
]
Distribution = Annotated[
    Path | None, typer.Option(help="Write a run's training distribution, as JSON.")
]
Policy = Annotated[Path | None, typer.Option(help="Write a run's policy.")]
Compare = Annotated[bool, typer.Option(help="Probability that a method beats another.")]
Cost = Annotated[bool, typer.Option(help="Core seconds of each kind of stage, and utilisation.")]


@app.command()
def results(
    id: Id,
    csv: AsCsv = False,
    figure: Figure = None,
    figures: Figures = None,
    distribution: Distribution = None,
    policy: Policy = None,
    compare: Compare = False,
    cost: Cost = False,
    url: Url = None,
    as_json: AsJson = False,
) -> None:
    """Show the result table, or write figures, the distribution or the policy."""
    asked = {"--figure": figure, "--figures": figures, "--distribution": distribution}
    asked |= {"--policy": policy, "--cost": cost, "--compare": compare, "--csv": csv}
    if len(given := [name for name, value in asked.items() if value]) > 1:
        raise InvalidInput(f"give one of {', '.join(given)}; --json has all tables")
    if as_json and given and given[0] not in ("--cost", "--compare"):
        raise InvalidInput(f"--json goes without {given[0]}, which writes another form")
    if (policy or distribution) and not id.startswith("run_"):
        raise InvalidInput(f"{id} is no run, and has no single policy or distribution; adr list")
    if figure is not None and figure.suffix not in _KINDS:
        raise InvalidInput(f"a figure ends in {', '.join(_KINDS)}; given {figure.name}")
    _check_places((figure, distribution, policy), figures)
    with connect(url) as client:
        _check_has(client, id, given)
        if figure is not None:
            _write(figure, client.figure(id, figure.name))
        elif figures is not None:
            _write_figures(client, id, figures)
        elif distribution is not None:
            _write(distribution, json.dumps(client.distribution(id), indent=1).encode())
        elif policy is not None:
            _write(policy, client.policy(id))
        elif cost:
            _show_cost(client, id, as_json)
        else:
            _show_table(client, id, csv, as_json, compare)


def _check_places(files: Sequence[Path | None], folder: Path | None) -> None:
    """Refuse files that are there already, and a folder that is a file."""
    for file in files:
        if file is not None:
            check_new(file)
    if folder is not None and folder.exists():
        folder.mkdir(exist_ok=True)  # raises for a file


def _check_has(client: AdrClient, id: str, asked: Sequence[str]) -> None:
    """Refuse to ask a criticism for what only other runs have."""
    for option in set(asked) & set(_OF_RUNS):
        if is_criticism(client.get(id)):
            raise InvalidInput(
                f"{id} is a criticism, which has a verdict and nothing for {option}; "
                f"`adr results {id}` prints it, and --json has its links"
            )


def _write_figures(client: AdrClient, id: str, folder: Path) -> None:
    files = [folder / f"{name}{kind}" for name in client.figures(id) for kind in _KINDS]
    if not files:
        raise InvalidInput(f"{id} has nothing to draw")
    folder.mkdir(parents=True, exist_ok=True)
    check_absent(*files)
    drawn = {file: client.figure(id, file.name) for file in files}  # all, or nothing is written
    for file, content in drawn.items():
        _write(file, content)


def _write(file: Path, content: bytes) -> None:
    with written_whole(file) as part:
        part.write_bytes(content)
    typer.echo(file)


def _show_cost(client: AdrClient, id: str, as_json: bool) -> None:
    spent = client.cost(id)
    if as_json:
        console.print_json(data=spent)
    else:
        console.print(cost_table(spent))


def _show_table(client: AdrClient, id: str, csv: bool, as_json: bool, compare: bool) -> None:
    if csv:
        typer.echo(client.results_csv(id), nl=False)
    elif compare and not as_json:
        console.print(comparisons_table(client.results(id)))
    elif not as_json:
        show_results(client, client.get(id))
    elif is_criticism(client.get(id)):
        console.print_json(data=client.criticism(id))
    else:
        console.print_json(data=client.results(id))


@app.command()
def report(
    benchmark: Annotated[str, typer.Argument(help="Id of a benchmark, finished or not.")],
    out: Annotated[Path, typer.Option(help="The folder to write.")],
    url: Url = None,
) -> None:
    """Write a benchmark's page as a folder of files for any web host, with its archive."""
    from api.report import write_report  # imports Matplotlib

    with connect(url) as client:
        typer.echo(write_report(client, benchmark, out))


@app.command()
def cite(id: Id, url: Url = None) -> None:
    """Print the papers of what was run, as BibTeX."""
    with connect(url) as client:
        typer.echo(client.citations(id), nl=False)


@app.command()
def claims(
    id: Annotated[str | None, typer.Argument(help="Id of a benchmark; default: all runs.")] = None,
    url: Url = None,
    as_json: AsJson = False,
) -> None:
    """Compare the paper's claims with the measured results."""
    with connect(url) as client:
        reports = client.claims(id)
    if as_json:
        console.print_json(data=reports)
        return
    if not reports:
        console.print("nothing has been measured yet that claims speak of (smoke does not count)")
    for report in reports:
        console.print(claims_table(report))
