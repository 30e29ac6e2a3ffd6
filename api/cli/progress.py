"""Progress of runs on a terminal."""

from rich.console import Console, Group, RenderableType
from rich.live import Live
from rich.progress_bar import ProgressBar
from rich.table import Table
from rich.text import Text

from adr_service.client import AdrClient, Json, is_finished
from adr_service.client.progress import headline, label, runs_of, stages_of
from adr_service.errors import remedy_of
from adr_service.json_values import printable

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


def failures(seen: Json) -> list[str]:
    """One text for each failed run: its error, and what a user can do."""
    return [
        f"{run['id']} failed: {_with_remedy(run['error'])}".replace("\n", "\n    ")
        for run in runs_of(seen)
        if run["error"]
    ]


def _with_remedy(error: Json) -> str:
    remedy = remedy_of(error["code"])
    return printable(error["message"]) + ("" if remedy is None else f"\n{remedy}")


def _progress(seen: Json) -> RenderableType:
    table = Table(box=None, padding=(0, 2, 0, 0), show_header=False)
    for run, stage in stages_of(runs_of(seen)):
        if stage["state"] != "running":
            continue
        spec, is_training = run["spec"], stage["kind"] == "train_policy"
        score = stage["facts"].get("source_return") if is_training else None
        table.add_row(
            f"{label(spec)} seed {spec['seed']}",
            stage["kind"],
            ProgressBar(total=1.0, completed=stage["fraction"], width=24),
            f"{stage['seconds']:.0f} s",
            "" if score is None else f"return in simulation {score:.0f}",
        )
    return Group(Text(headline(seen)), table)
