"""The command line, `adr`: starts the service, or is its client."""

import json
import os
import socket
import sys
from functools import partial
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from adr_service.errors import AdrError, InvalidInput
from adr_service.progress import silent
from api import demo as demo_story
from api import recordings, upkeep
from api.client import AdrClient, is_finished
from api.display import (
    claims_table,
    comparisons_table,
    cost_table,
    failures,
    label,
    live,
    plan_table,
    results_table,
    trials_table,
    verdict_table,
)
from api.settings import DEFAULT_URL, Settings, read_settings

app = typer.Typer(
    help="Benchmark adaptive domain randomization.", no_args_is_help=True, add_completion=False
)
app.add_typer(upkeep.app, name="db")
# a table needs its width where no terminal tells one
console = Console(width=None if sys.stdout.isatty() or "COLUMNS" in os.environ else 120)
errors = Console(stderr=True)

Url = Annotated[str, typer.Option(envvar="ADR_URL", help="Address of the service.")]
AsJson = Annotated[bool, typer.Option("--json", help="Print the service's JSON.")]
Id = Annotated[str, typer.Argument(help="Id of a run or a benchmark.")]


@app.command()
def serve(
    host: Annotated[str | None, typer.Option(help="Address to listen on.")] = None,
    port: Annotated[int | None, typer.Option(help="Port to listen on.")] = None,
    data_dir: Annotated[Path | None, typer.Option(help="Where results are kept.")] = None,
    cpus: Annotated[int | None, typer.Option(help="Cores of a local cluster.")] = None,
    dashboard: Annotated[bool | None, typer.Option(help="Start the Ray dashboard.")] = None,
) -> None:
    """Start the service; what was unfinished goes on."""
    given = {"host": host, "port": port, "data_dir": data_dir, "cpus": cpus, "dashboard": dashboard}
    settings = read_settings(**{name: v for name, v in given.items() if v is not None})
    _refuse_a_busy_port(settings)
    if settings.ray_address == "local":
        # Ray, when it is imported, learns here whose end is ours too. Where nothing is said and our
        # parent is process 1, it ends us as an orphan with the raylet, which we start again here
        # alone: with another cluster's, the service may end, for its supervisor to restart it
        os.environ["RAY_RAYLET_PID"] = str(os.getpid())
    # only the service needs Ray, MuJoCo and PyTorch, whose imports take seconds
    import uvicorn

    from api.app import create_app
    from api.connections import bounded, connections_allowed
    from api.logs import configure

    configure(settings.log_format)
    os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")  # no calls home
    sys.setswitchinterval(0.0005)  # many threads: who answers should not wait 5 ms for each of them
    uvicorn.run(
        create_app(settings),
        host=settings.host,
        port=settings.port,
        # on h11: httptools, which is faster, keeps headers of any size in memory
        http=bounded(connections_allowed(settings.max_connections)),
        log_config=None,  # ours
        timeout_keep_alive=30,  # longer than clients do, whose requests would meet an end
        timeout_graceful_shutdown=5,  # for those who follow a stream
    )


@app.command()
def submit(
    file: Annotated[Path | None, typer.Argument(help="JSON of a run or a benchmark.")] = None,
    task: Annotated[str | None, typer.Option(help="arm, hopper, half_cheetah, …")] = None,
    method: Annotated[str | None, typer.Option(help="simopt, dropo, droid, udr, …")] = None,
    variant: Annotated[
        str | None, typer.Option(help="vanilla (the default), noisy or unmodeled.")
    ] = None,
    seed: Annotated[int | None, typer.Option(help="0 by default.")] = None,
    preset: Annotated[
        str | None, typer.Option(help="smoke, demo, quick (the default) or paper.")
    ] = None,
    dataset: Annotated[
        str | None, typer.Option(help="Learn from this uploaded recording, without a target.")
    ] = None,
    extension: Annotated[
        Path | None, typer.Option(help="Extend the source by effects.json of `adr criticise`.")
    ] = None,
    setting: Annotated[
        list[str] | None,
        typer.Option("--set", help="A field of the spec, training.max_steps=1000 or iterations=2."),
    ] = None,
    dry_run: Annotated[bool, typer.Option(help="Say what it would cost; start nothing.")] = False,
    watch: Annotated[bool, typer.Option(help="Follow it to its end.")] = False,
    url: Url = DEFAULT_URL,
    as_json: AsJson = False,
) -> None:
    """Submit a run (by options) or a run or benchmark (by file)."""
    given: dict[str, Any] = {
        "task": task,
        "method": method,
        "variant": variant,
        "seed": seed,
        "preset": preset,
        "target": None if dataset is None else {"kind": "recorded", "dataset": dataset},
    }
    spec = {name: value for name, value in given.items() if value is not None}
    if (file is None) == (not spec) or (spec and not {"task", "method"} <= spec.keys()):
        raise InvalidInput(
            "give either --task and --method, or a JSON file alone (and --set for its fields)"
        )
    if file is not None:
        spec = _read_json(file)
    if extension is not None:
        spec["extension"] = _effects_of(extension)
    for assignment in setting or []:
        _assign(spec, assignment)
    with _client(url) as client:
        send = client.submit_benchmark if "tasks" in spec else client.submit_run
        answer = send(spec, dry_run=dry_run)
        if as_json:
            console.print_json(data=answer)
        elif dry_run:
            console.print(plan_table(answer["plan"]))
        else:
            console.print(answer["id"])
        if watch and not dry_run:
            _follow(client, answer["id"])


@app.command()
def upload(
    file: Annotated[Path, typer.Argument(help="An .npz, or PREFIX of DROPO's PREFIX_*.npy.")],
    task: Annotated[str, typer.Option(help="Whose recording it is.")],
    url: Url = DEFAULT_URL,
) -> None:
    """Store a recording of a real machine, to learn from; prints its id."""
    with _client(url) as client:
        stored = client.upload(recordings.read(file, task), task)
    console.print(stored["id"])


@app.command()
def datasets(url: Url = DEFAULT_URL) -> None:
    """List uploaded recordings."""
    with _client(url) as client:
        stored = client.list_all("datasets")
    table = Table("id", "transitions", "episodes", "period", "origin", box=None)
    for data in stored:
        counts = (str(data["transitions"]), str(data["episodes"]), f"{data['dt']:g} s")
        table.add_row(data["id"], *counts, data["origin"])
    console.print(table if stored else "no recordings yet; `adr upload` stores one")


@app.command()
def extend(
    id: Annotated[str, typer.Argument(help="Id of a benchmark.")],
    seed: Annotated[list[int] | None, typer.Option(help="One more seed.")] = None,
    method: Annotated[list[str] | None, typer.Option(help="One more method.")] = None,
    variant: Annotated[list[str] | None, typer.Option(help="One more variant.")] = None,
    task: Annotated[list[str] | None, typer.Option(help="One more task.")] = None,
    collector: Annotated[list[str] | None, typer.Option(help="One more collector.")] = None,
    watch: Annotated[bool, typer.Option(help="Follow it to its end.")] = False,
    url: Url = DEFAULT_URL,
) -> None:
    """Add runs to a benchmark; what it has computed stays."""
    given = {
        "seeds": seed,
        "methods": method,
        "variants": variant,
        "tasks": task,
        "collectors": collector,
    }
    if not id.startswith("bench_"):
        raise InvalidInput(f"only a benchmark can be extended; given {id}")
    with _client(url) as client:
        client.extend_benchmark(id, {name: value for name, value in given.items() if value})
        console.print(f"{id} goes on")
        if watch:
            _follow(client, id)


@app.command("list")
def list_command(url: Url = DEFAULT_URL, as_json: AsJson = False) -> None:
    """List benchmarks and runs."""
    with _client(url) as client:
        benchmarks, runs = client.list_all("benchmarks"), client.list_all("runs")
    if as_json:
        console.print_json(data={"benchmarks": benchmarks, "runs": runs})
        return
    table = Table("id", "task", "variant", "method", "seed", "preset", "state", box=None)
    for run in runs:
        spec = run["spec"]
        cells = (spec["task"], spec["variant"], label(spec), str(spec["seed"]))
        table.add_row(run["id"], *cells, spec.get("preset", ""), run["state"])
    console.print(table if runs else "no runs yet; `adr demo` makes some")
    for benchmark in benchmarks:
        states = ", ".join(f"{count} {state}" for state, count in benchmark["states"].items())
        console.print(f"{benchmark['id']}: {states}")


@app.command()
def status(id: Id, url: Url = DEFAULT_URL) -> None:
    """Show everything the service knows of a run or a benchmark, as JSON."""
    with _client(url) as client:
        console.print_json(data=client.get(id))


@app.command()
def watch(id: Id, url: Url = DEFAULT_URL) -> None:
    """Follow a run or a benchmark to its end; exit status 1 if something failed."""
    with _client(url) as client:
        _follow(client, id)


@app.command()
def results(
    id: Id,
    csv: Annotated[bool, typer.Option("--csv", help="As CSV.")] = False,
    figure: Annotated[
        Path | None, typer.Option(help="Write a figure: returns.svg, parameters.png, cost.csv, …")
    ] = None,
    figures: Annotated[
        Path | None, typer.Option(help="Write all figures into this folder, as SVG, PNG and CSV.")
    ] = None,
    distribution: Annotated[
        Path | None, typer.Option(help="Write what a run's policy was trained on, as JSON.")
    ] = None,
    policy: Annotated[Path | None, typer.Option(help="Write a run's policy.")] = None,
    compare: Annotated[bool, typer.Option(help="Probability that a method beats another.")] = False,
    cost: Annotated[bool, typer.Option(help="What it cost, and how busy the cores were.")] = False,
    url: Url = DEFAULT_URL,
    as_json: AsJson = False,
) -> None:
    """Show the result table, or write figures, the distribution or the policy."""
    if (policy or distribution) and not id.startswith("run_"):
        raise InvalidInput(f"{id} is no run, and has no single policy or distribution; adr list")
    with _client(url) as client:
        if figure is not None:
            _write(figure, client.figure(id, figure.name))
        elif figures is not None:
            figures.mkdir(parents=True, exist_ok=True)
            for name in client.figures(id):
                for file in (f"{name}.{kind}" for kind in ("svg", "png", "csv")):
                    _write(figures / file, client.figure(id, file))
        elif distribution is not None:
            _write(distribution, json.dumps(client.distribution(id), indent=1).encode())
        elif policy is not None:
            _write(policy, client.policy(id))
        elif cost:
            found = client.cost(id)
            console.print_json(data=found) if as_json else console.print(cost_table(found))
        elif csv:
            typer.echo(client.results_csv(id), nl=False)
        elif as_json:
            console.print_json(data=client.results(id))
        elif compare:
            console.print(comparisons_table(client.results(id)))
        else:
            _show_results(client, client.get(id))


@app.command()
def claims(
    id: Annotated[str | None, typer.Argument(help="Of one benchmark; default: of all.")] = None,
    url: Url = DEFAULT_URL,
    as_json: AsJson = False,
) -> None:
    """Hold the paper's claims against what was measured."""
    with _client(url) as client:
        reports = client.claims(id)
    if as_json:
        console.print_json(data=reports)
    elif not reports:
        console.print("nothing has been measured yet (the preset smoke does not count)")
    for report in [] if as_json else reports:
        console.print(claims_table(report))


@app.command()
def cancel(id: Id, url: Url = DEFAULT_URL) -> None:
    """Ask a run, or all live runs of a benchmark, to stop."""
    with _client(url) as client:
        had_ended = is_finished(client.get(id))
        client.cancel(id)
    told = "had ended before" if had_ended else "is asked to stop"
    console.print(f"{id} {told}; finished stages are kept")


@app.command()
def resume(id: Id, url: Url = DEFAULT_URL) -> None:
    """Go on with a failed or cancelled run or benchmark."""
    with _client(url) as client:
        states = client.get(id).get("states")  # of a benchmark; a run is refused by the service
        client.resume(id)
    has_some = states is None or states.keys() & {"failed", "cancelled"}
    console.print(f"{id} {'goes on' if has_some else 'has no run that failed or was cancelled'}")


@app.command()
def demo(
    data_dir: Annotated[Path, typer.Option(help="Where results are kept.")] = Path("data/demo"),
    port: Annotated[int, typer.Option(help="0: any free port.")] = 0,
) -> None:
    """Run a small benchmark from nothing to its figures, in minutes."""
    raise typer.Exit(demo_story.tell(console, data_dir, port))


@app.command()
def render(
    out: Annotated[Path, typer.Argument(help="The film to write, .gif or .mp4.")],
    task: Annotated[str, typer.Option(help="arm, hopper, half_cheetah, …")],
    policy: Annotated[Path | None, typer.Option(help="Film an episode of this policy.")] = None,
    data: Annotated[
        Path | None, typer.Option(help="Film a recorded episode (.npz) beside its replay.")
    ] = None,
    variant: Annotated[str, typer.Option(help="vanilla, noisy or unmodeled.")] = "vanilla",
    setting: Annotated[
        list[str] | None,
        typer.Option("--set", help="A parameter, torso_mass=4.2; all others are true."),
    ] = None,
    episode: Annotated[int, typer.Option(help="Of the recording, from 0.")] = 0,
    steps: Annotated[int | None, typer.Option(help="At most; an episode.", min=1)] = None,
    seed: Annotated[int, typer.Option(help="Of the initial state and the noise.")] = 0,
) -> None:
    """Film a policy, or a recording beside its simulation; needs no service and no display."""
    from api import films  # imports the simulator

    dynamics: dict[str, Any] = {}
    for assignment in setting or []:
        _assign(dynamics, assignment)
    scene = films.Scene(task, variant, dynamics, steps, seed)
    if policy is not None and data is None:
        count = films.film_policy(scene, policy, out)
    elif data is not None and policy is None:
        count = films.film_recording(scene, data, episode, out)
    else:
        raise InvalidInput("give either --policy or --data")
    console.print(f"{out}: {count} pictures", highlight=False)


@app.command()
def criticise(
    out: Annotated[Path, typer.Option(help="Folder for verdict, report and extended model.")],
    data: Annotated[
        Path | None, typer.Option(help="The measurement, .npz or .csv; see docs/criticism.md.")
    ] = None,
    dataset: Annotated[
        str | None, typer.Option(help="Or one that was uploaded: the service criticises.")
    ] = None,
    task: Annotated[str | None, typer.Option(help="A task's simulator: arm, hopper, …")] = None,
    variant: Annotated[
        str | None, typer.Option(help="Of the task, what its simulator has wrong: vanilla, …")
    ] = None,
    model: Annotated[Path | None, typer.Option(help="Or your own MJCF, a file you trust.")] = None,
    free: Annotated[
        list[str] | None,
        typer.Option(help="What may be fitted of --model: body:thigh.mass=1:5, …"),
    ] = None,
    seed: Annotated[int, typer.Option(help="Of the bootstraps.")] = 0,
    url: Url = DEFAULT_URL,
) -> None:
    """Name what a simulator gets wrong, given measured data; with --data, without a service."""
    if (data is None) == (dataset is None):
        raise InvalidInput("give either --data or --dataset")
    if out.exists() and not out.is_dir():
        raise InvalidInput(f"{out} is a file; --out is a folder")
    if data is None:
        if task is None or model is not None or free:
            raise InvalidInput("--dataset goes with --task; the service takes no --model or --free")
        spec = {"task": task, "variant": variant or "vanilla", "dataset": dataset, "seed": seed}
        with _client(url) as client:
            _criticised(client, client.submit_criticism(spec)["run"]["id"], out)
        return
    from api import criticism  # imports the simulator

    nominal, name = criticism.nominal_of(task, variant, model, free or [])
    with console.status("fitting"):
        found = criticism.criticise_files(nominal, name, data, out, seed, silent)
    console.print(verdict_table(found.verdict.to_json()))
    console.print(f"{out}: {', '.join(criticism.FILES[: 4 if found.extension else 2])}")


@app.command()
def tune(
    task: Annotated[str, typer.Argument(help="arm, hopper, half_cheetah, …")],
    rates: Annotated[str, typer.Option(help="Learning rates, with commas between.")],
    seeds: Annotated[int, typer.Option(help="Trainings per rate.", min=1)] = 2,
    preset: Annotated[str, typer.Option(help="Whose trainings: quick, paper, …")] = "quick",
    setting: Annotated[
        list[str] | None, typer.Option("--set", help="A field, training.max_steps=1000.")
    ] = None,
    cpus: Annotated[int | None, typer.Option(help="Trainings at once; default: all cores.")] = None,
    as_json: AsJson = False,
) -> None:
    """Search the learning rate that trains best on the ground truth; needs no service."""
    from api import tuning  # imports Ray and the simulator

    spec: dict[str, Any] = {"task": task, "method": "oracle", "preset": preset}
    for assignment in setting or []:
        _assign(spec, assignment)
    trials = tuning.search(spec, rates.split(","), seeds, cpus)
    if as_json:
        console.print_json(data=trials)
    else:
        console.print(trials_table(trials))


@app.command()
def robot(
    env: Annotated[str, typer.Option(help="module:factory of a Gymnasium environment.")],
    task: Annotated[str, typer.Option(help="Whose target it is: hopper, …")],
    name: Annotated[str, typer.Option(help="Shown to those who watch.")] = "robot",
    max_seconds: Annotated[
        float | None, typer.Option(help="An episode never takes longer.", min=0.1)
    ] = None,
    max_reset_seconds: Annotated[
        float, typer.Option(help="Longer resets mean that the environment hangs.", min=0.1)
    ] = 120.0,
    max_action: Annotated[
        list[float] | None,
        typer.Option(help="No action beyond ± this; once for all, or once for each."),
    ] = None,
    episodes: Annotated[int | None, typer.Option(help="Then stop.", min=1)] = None,
    url: Url = DEFAULT_URL,
) -> None:
    """Run the episodes that runs with an external target ask for; see docs/robots.md."""
    from api import robot as client_of_a_robot  # imports Gymnasium

    limits = client_of_a_robot.Limits(max_seconds, max_reset_seconds, tuple(max_action or ()))
    connect = partial(AdrClient, url, os.environ.get("ADR_TOKEN", ""))
    worker = client_of_a_robot.Robot(connect, task, env, name, limits, console.print)
    worker.work(episodes)


@app.command()
def doctor() -> None:
    """Check what the service needs on this machine."""
    from api.doctor import check

    raise typer.Exit(check(console))


def main() -> None:
    """The console script: expected errors are messages, not tracebacks."""
    try:
        app()
    except (AdrError, OSError) as error:
        errors.print(f"[red]error:[/red] {escape(str(error))}", highlight=False, soft_wrap=True)
        raise SystemExit(2) from error


def _refuse_a_busy_port(settings: Settings) -> None:
    """Before Ray is started, which takes seconds."""
    family = socket.AF_INET6 if ":" in settings.host else socket.AF_INET
    with socket.socket(family) as probe:
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            probe.bind((settings.host, settings.port))
        except OSError as error:
            raise InvalidInput(
                f"cannot listen on {settings.host} port {settings.port} ({error.strerror}); "
                "choose another with --port, and tell the other commands with ADR_URL"
            ) from error


def _client(url: str) -> AdrClient:
    return AdrClient(url, os.environ.get("ADR_TOKEN", ""))


def _criticised(client: AdrClient, id: str, out: Path) -> None:
    """Follow a criticism to its end, and write its files."""
    from api import criticism  # imports the simulator

    console.print(id, highlight=False)
    _follow(client, id)
    found = client.criticism(id)
    names = [name for name in criticism.FILES if name in found["links"]]
    criticism.write(out, {name: client.criticism_file(id, name) for name in names})
    console.print(f"{out}: {', '.join(names)}")


def _follow(client: AdrClient, id: str) -> None:
    final = live(console, client, id)
    _show_results(client, final)
    states = final["states"] if "states" in final else {final["state"]: 1}
    for line in failures(final):
        errors.print(escape(line), highlight=False, soft_wrap=True)
    if set(states) != {"succeeded"}:
        raise typer.Exit(1)


def _show_results(client: AdrClient, seen: dict[str, Any]) -> None:
    """The result table of a run or a benchmark, or the verdict of a criticism."""
    if seen["spec"].get("kind") != "criticism":
        console.print(results_table(client.results(seen["id"])))
        return
    verdict = client.criticism(seen["id"])["verdict"]
    error = (seen["error"] or {}).get("message", "no verdict yet")
    console.print(f"{seen['state']}: {error}" if verdict is None else verdict_table(verdict))


def _write(file: Path, content: bytes) -> None:
    file.write_bytes(content)
    typer.echo(file)


def _read_json(file: Path) -> dict[str, Any]:
    try:
        spec = json.loads(file.read_text())
    except (OSError, ValueError) as error:
        raise InvalidInput(f"{file} is not a readable JSON file: {error}") from error
    if not isinstance(spec, dict):
        raise InvalidInput(f"{file} must hold one JSON object")
    return spec


def _effects_of(file: Path) -> list[dict[str, Any]]:
    """The effects that a criticism named, as a spec takes them."""
    content = _read_json(file)
    effects, version = content.get("effects"), content.get("version")
    if (
        version != 1
        or not isinstance(effects, list)
        or not all(isinstance(e, dict) for e in effects)
    ):
        raise InvalidInput(
            f"{file} is no list of effects, version 1; give effects.json of `adr criticise`"
        )
    return [{k: v for k, v in effect.items() if k != "in_mjcf"} for effect in effects]


def _assign(spec: dict[str, Any], assignment: str) -> None:
    """Set `a.b=value` in a spec; the value is JSON, or else text."""
    path, equals, text = assignment.partition("=")
    if not equals:
        raise InvalidInput(f"--set needs name=value; given {assignment!r}")
    try:
        value = json.loads(text)
    except ValueError:
        value = text
    *parents, last = path.split(".")
    inner = spec
    for name in parents:
        # a method given by name becomes an object when one of its settings is set
        if not isinstance(inner.get(name), dict):
            inner[name] = {"name": inner[name]} if name == "method" and name in inner else {}
        inner = inner[name]
    inner[last] = value
