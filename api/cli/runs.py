"""Submit runs and benchmarks, follow them, and stop or continue them."""

import time
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.padding import Padding
from rich.table import Table

from adr_service.client import AdrClient, Json, connect, is_finished
from adr_service.client.progress import label
from adr_service.errors import InvalidInput
from api.cli.follow import follow
from api.cli.options import AsJson, Id, Url, Watch, check_watch, members
from api.cli.single_options import SingleOptionApp
from api.cli.tables import plan_table
from api.cli.terminal import console, errors
from api.specs import assign, read_effects, read_spec

app = SingleOptionApp()
_STOPPING_S = 60.0  # for runs that were just asked to stop

SpecFile = Annotated[Path | None, typer.Argument(help="JSON file of a run or a benchmark.")]
Task = Annotated[str | None, typer.Option(help="arm, hopper, half_cheetah, …")]
Method = Annotated[str | None, typer.Option(help="simopt, dropo, droid, udr, …")]
Variant = Annotated[
    str | None, typer.Option(help="vanilla (the default), noisy, unmodeled, edge or outside.")
]
Seed = Annotated[int | None, typer.Option(help="0 by default.")]
Preset = Annotated[str | None, typer.Option(help="quick (the default), fast, paper, …")]
Dataset = Annotated[
    str | None, typer.Option(help="Learn from this uploaded recording, without a target.")
]
Extension = Annotated[
    Path | None, typer.Option(help="Extend the source by effects.json of `adr criticise`.")
]
Fields = Annotated[
    list[str] | None,
    typer.Option("--set", help="A field of the spec, training.max_steps=1000 or iterations=2."),
]
Key = Annotated[
    str | None,
    typer.Option(help="A name: nothing is submitted twice under it within a day."),
]
DryRun = Annotated[bool, typer.Option(help="Print the expected cost; start nothing.")]
More = Annotated[list[str] | None, typer.Option(help="Add one; may be repeated.")]


@app.command()
def submit(
    file: SpecFile = None,
    task: Task = None,
    method: Method = None,
    variant: Variant = None,
    seed: Seed = None,
    preset: Preset = None,
    dataset: Dataset = None,
    extension: Extension = None,
    setting: Fields = None,
    key: Key = None,
    dry_run: DryRun = False,
    watch: Watch = False,
    url: Url = None,
    as_json: AsJson = False,
) -> None:
    """Submit a run (by options), or a run or benchmark (by file)."""
    check_watch(dry_run, watch, key)
    by_options: dict[str, Any] = {"task": task, "method": method, "variant": variant}
    by_options |= {"seed": seed, "preset": preset, "target": _recorded(dataset)}
    given = {name: value for name, value in by_options.items() if value is not None}
    spec = _spec(file, given)
    if extension is not None:
        spec["extension"] = given["extension"] = read_effects(extension)
    within = {"method": ["name"], "target": ["kind", "dataset"]}  # what these options say
    said = [f"{name}.{field}" for name in given for field in within.get(name, ())]
    assign(spec, setting, fixed=[*given, *said])
    with connect(url) as client:
        _show(client, _send(client, spec, dry_run, key), "", dry_run, watch, as_json)


def _recorded(dataset: str | None) -> Json | None:
    return None if dataset is None else {"kind": "recorded", "dataset": dataset}


def _spec(file: Path | None, by_options: Json) -> Json:
    if file is not None and by_options.keys() <= {"preset"}:  # a field of runs and of benchmarks
        return read_spec(file) | by_options
    if file is None and {"task", "method"} <= by_options.keys():
        return by_options
    raise InvalidInput(
        "give either --task and --method, or a JSON file, beside which --preset, --extension and "
        "--set change its fields, as in --set seed=3 or --set 'seeds=[3, 4]'"
    )


def _send(client: AdrClient, spec: Json, dry_run: bool, key: str | None) -> Json:
    send = client.submit_benchmark if "tasks" in spec else client.submit_run
    return send(spec, dry_run=dry_run, key=key)


def _show(
    client: AdrClient, answer: Json, remark: str, dry_run: bool, watch: bool, as_json: bool
) -> None:
    """Print the answer to a request, with a remark, and follow what it started."""
    if as_json and not watch:
        console.print_json(data=answer)
    elif dry_run:
        console.print(plan_table(answer["plan"]))
    else:  # with a document at the end, at once, so that a user who interrupts knows the id
        (errors if as_json else console).print(f"{answer['id']}{remark}")
    if watch:
        follow(client, answer["id"], as_json)


@app.command()
def extend(
    id: Annotated[str, typer.Argument(help="Id of a benchmark.")],
    seed: Annotated[list[int] | None, typer.Option(help="Add one; may be repeated.")] = None,
    method: More = None,
    variant: More = None,
    task: More = None,
    collector: More = None,
    dry_run: DryRun = False,
    watch: Watch = False,
    url: Url = None,
    as_json: AsJson = False,
) -> None:
    """Add runs to a benchmark; its results so far stay."""
    check_watch(dry_run, watch)
    if not id.startswith("bench_"):
        raise InvalidInput(f"only a benchmark can be extended; given {id}")
    extension = members(seed=seed, method=method, variant=variant, task=task, collector=collector)
    with connect(url) as client:
        answer = client.extend_benchmark(id, extension, dry_run=dry_run)
        _show(client, answer, " goes on", dry_run, watch, as_json)


@app.command("list")
def list_all(
    task: Annotated[str | None, typer.Option(help="Only of this task.")] = None,
    method: Annotated[str | None, typer.Option(help="Only runs of this method.")] = None,
    state: Annotated[str | None, typer.Option(help="Only runs in it: running, failed, …")] = None,
    url: Url = None,
    as_json: AsJson = False,
) -> None:
    """List benchmarks with their runs, then single runs, each in order of submission."""
    filters = {"task": task, "method": method, "state": state}
    given = {name: value for name, value in filters.items() if value is not None}
    with connect(url) as client:
        # a benchmark that is submitted meanwhile has no run among these
        runs, benchmarks = client.list_all("runs", **given), client.list_all("benchmarks")
    if given:
        listed = {run["benchmark_id"] for run in runs}
        benchmarks = [benchmark for benchmark in benchmarks if benchmark["id"] in listed]
    if as_json:
        console.print_json(data={"benchmarks": benchmarks, "runs": runs})
        return
    if not runs:
        console.print("no such runs" if given else "no runs yet; `adr demo` makes some")
    for benchmark in benchmarks:
        states = ", ".join(f"{count} {state}" for state, count in benchmark["states"].items())
        console.print(f"{benchmark['id']}, {_day(benchmark)} UTC: {states}")
        _print_runs([run for run in runs if run["benchmark_id"] == benchmark["id"]])
    if single := [run for run in runs if run["benchmark_id"] is None]:
        console.print("single runs")
        _print_runs(single)


def _day(listed: Json) -> str:
    """When a run or a benchmark was submitted, to the minute, UTC."""
    return str(listed["created_at"])[:16].replace("T", " ")


def _print_runs(runs: list[Json]) -> None:
    console.print(Padding(runs_table(runs), (0, 0, 1, 2)))


def runs_table(runs: list[Json]) -> Table:
    """A row for each run, which fits into 80 columns."""
    table = Table(box=None, padding=(0, 1, 0, 0), pad_edge=False)
    for heading in ("id", "task, variant", "method", "seed", "state", "at (UTC)"):
        table.add_column(heading, no_wrap=heading == "id", overflow="fold")
    for run in runs:
        spec = run["spec"]
        cells = (f"{spec['task']}, {spec['variant']}", label(spec), str(spec["seed"]))
        table.add_row(run["id"], *cells, run["state"], _day(run)[5:])  # no year
    return table


@app.command()
def status(id: Id, url: Url = None) -> None:
    """Print a run or a benchmark as the service's JSON."""
    with connect(url) as client:
        console.print_json(data=client.get(id))


@app.command()
def watch(id: Id, url: Url = None, as_json: AsJson = False) -> None:
    """Follow a run or a benchmark to its end; exit status 1 if something failed."""
    with connect(url) as client:
        follow(client, id, as_json)


@app.command()
def cancel(id: Id, url: Url = None, as_json: AsJson = False) -> None:
    """Ask a run, or all live runs of a benchmark, to stop."""
    with connect(url) as client:
        had_ended = is_finished(client.get(id))
        answer = client.cancel(id)
    if as_json:
        console.print_json(data=answer)
        return
    state = "had ended before" if had_ended else "is asked to stop"
    console.print(f"{id} {state}; finished stages are kept")


@app.command()
def resume(id: Id, url: Url = None, as_json: AsJson = False) -> None:
    """Continue a failed or cancelled run or benchmark, once what is being cancelled has stopped."""
    with connect(url) as client:
        seen, until = client.get(id), time.monotonic() + _STOPPING_S
        if _is_stopping(seen):
            errors.print("waiting for what is being cancelled")
        while _is_stopping(seen) and time.monotonic() < until:
            time.sleep(2.0)
            seen = client.get(id)
        states = seen.get("states")  # of a benchmark; a run is refused by the service
        answer = client.resume(id)
    if as_json:
        console.print_json(data=answer)
        return
    if _is_stopping(seen):
        errors.print(f"some runs of {id} are still stopping, and do not go on; resume it again")
    has_some = states is None or states.keys() & {"failed", "cancelled"}
    console.print(f"{id} {'goes on' if has_some else 'has no run that failed or was cancelled'}")


def _is_stopping(seen: Json) -> bool:
    """True if a run, or one of a benchmark, was asked to stop and has not yet."""
    runs = seen.get("runs", [seen])
    return any(run["cancel_requested"] and not is_finished(run) for run in runs)
