"""Progress of runs on a terminal."""

from collections.abc import Iterable
from typing import Any

from rich.console import Console, Group, RenderableType
from rich.live import Live
from rich.progress_bar import ProgressBar
from rich.table import Table
from rich.text import Text

from adr_service.errors import remedy_of
from adr_service.json_values import printable
from api.client import AdrClient, Json, is_finished

_REPORT_EVERY = 20  # polls, if the output is not a terminal


def live(console: Console, client: AdrClient, id: str) -> Json:
    """Show progress until the run or benchmark has finished; return its last state."""
    seen: Json = {}
    if not console.is_terminal:
        for poll, seen in enumerate(client.watch(id)):
            if poll % _REPORT_EVERY == 0 or is_finished(seen):
                console.print(headline(seen), highlight=False, soft_wrap=True)
        return seen
    with Live(console=console, refresh_per_second=4) as screen:
        for seen in client.watch(id):
            screen.update(_progress(seen))
    return seen


def headline(seen: Json) -> str:
    """One line on the runs that are done, the stages in work, and those that wait."""
    runs = _runs(seen)
    finished = sum(run["state"] == "succeeded" for run in runs)
    broken = sorted({run["state"] for run in runs} & {"failed", "cancelled"})
    others = [f", others {' and '.join(broken)}"] if broken else []
    return "".join([f"{finished}/{len(runs)} runs done", *others, *_in_work(_stages(runs))])


def _in_work(stages: Iterable[tuple[Json, Json]]) -> list[str]:
    """Parts of the headline on stages that run or wait."""
    running: list[str] = []
    robots: list[str] = []
    cores = 0
    for run, stage in stages:
        spec, kind = run["spec"], stage["kind"]
        if stage["state"] == "running":
            running.append(f"{label(spec)}/{spec['seed']} {kind} {stage['fraction']:.0%}")
        elif stage["state"] == "waiting" and kind == "target_episode":
            robots.append(spec["task"])
        elif stage["state"] == "waiting":
            cores += 1
    parts = [f"; now {', '.join(running)}"] if running else []
    parts += [f"; {_waiting(cores)} for a core"] if cores else []
    tasks = ", ".join(sorted(set(robots)))
    return parts + ([f"; {len(robots)} episodes wait for a robot of {tasks}"] if robots else [])


def failures(seen: Json) -> list[str]:
    """One text for each failed run: its error, and what a user can do."""
    return [
        f"{run['id']} failed: {_with_remedy(run['error'])}".replace("\n", "\n    ")
        for run in _runs(seen)
        if run["error"]
    ]


def _with_remedy(error: Json) -> str:
    remedy = remedy_of(error["code"])
    return printable(error["message"]) + ("" if remedy is None else f"\n{remedy}")


def label(spec: Json) -> str:
    """One word for a run: its method, or its kind."""
    return spec["method"]["name"] if "method" in spec else spec["kind"]


def _progress(seen: Json) -> RenderableType:
    table = Table(box=None, padding=(0, 2, 0, 0), show_header=False)
    for run, stage in _stages(_runs(seen)):
        if stage["state"] != "running":
            continue
        spec, facts = run["spec"], stage["facts"]
        score = facts.get("source_return")
        table.add_row(
            f"{label(spec)} seed {spec['seed']}",
            stage["kind"],
            ProgressBar(total=1.0, completed=stage["fraction"], width=24),
            f"{stage['seconds']:.0f} s",
            "" if score is None else f"return in simulation {score:.0f}",
        )
    return Group(Text(headline(seen)), table)


def _runs(seen: Json) -> list[Json]:
    return seen.get("runs", [seen])


def _stages(runs: Iterable[Json]) -> list[tuple[Json, dict[str, Any]]]:
    """(run, stage) of every stage that runs or waits; a stage that runs share appears once."""
    first: dict[str, tuple[Json, dict[str, Any]]] = {}
    for run in runs:
        for stage in run["progress"]:
            first.setdefault(stage["digest"], (run, stage))
    return list(first.values())


def _waiting(stages: int) -> str:
    return "1 stage waits" if stages == 1 else f"{stages} stages wait"
