"""Results, costs and plans as tables on a terminal."""

import json
import statistics
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

from rich.console import Group, RenderableType
from rich.table import Table
from rich.text import Text

from adr_service.benchmark.cost import USES
from adr_service.client import Json
from api.durations import in_words

if TYPE_CHECKING:  # imports Ray
    from workers.tuning import Candidate


def results_table(results: Json) -> RenderableType:
    """The result table with its intervals."""
    if results["rows"]:
        return Group(*_by_place(results["rows"], _returns), Text(results["note"], style="dim"))
    if results["estimates"]:
        return Group(estimates_table(results), Text(results["note"], style="dim"))
    return Text("no iteration has finished yet")


def _by_place(rows: Sequence[Json], table: Callable[[Sequence[Json]], Table]) -> list[Table]:
    """A table for each task's variant, so that names stay whole on 80 columns."""
    places: dict[str, list[Json]] = {}
    for row in rows:
        places.setdefault(f"{row['task']}, {row['variant']}", []).append(row)
    tables = {place: table(group) for place, group in places.items()}
    for place, each in tables.items():
        each.title, each.title_justify, each.title_style = place, "left", "bold"
    return list(tables.values())


def _returns(rows: Sequence[Json]) -> Table:
    cells = [_cells(row) for row in rows]
    words = [word for method, *_ in cells for word in method.split()]
    table = Table(box=None, padding=(0, 1, 0, 0), pad_edge=False)
    table.add_column("method", min_width=max(map(len, words)))
    for heading in (
        *("iter-\nation", "return /\nthreshold", "95 %\ninterval", "seeds", "epi-\nsodes"),
        *("target\ntransi-\ntions", "distance\nfrom\ntruth", "poste-\nrior\nstd"),
    ):
        table.add_column(heading, justify="right", no_wrap=True)
    for row in cells:
        table.add_row(*row)
    return table


def _cells(row: Json) -> list[str]:
    error, std = row["estimation_error"], row["posterior_std"]
    collector = "" if row["collector"] == "simopt" else f" on {row['collector']}"
    return [
        row["method"] + collector,
        str(row["iteration"]),
        f"{row['normalised_return']:.2f}",
        _interval(row),
        str(row["seeds"]),
        str(row["episodes"]),
        f"{row['target_transitions']:.0f}",
        "–" if error is None else f"{error:.2f}",
        "–" if std is None else f"{std:.2g}",
    ]


def _interval(row: Json, of: str = "") -> str:
    """The interval of a row; fewer than three seeds have none."""
    low, high = row[f"{of}low"], row[f"{of}high"]
    return "–" if low is None else f"[{low:.2f}, {high:.2f}]"


def estimates_table(results: Json) -> RenderableType:
    """The estimates of each method, by parameter."""
    table = Table(box=None, padding=(0, 1, 0, 0), pad_edge=False)
    for heading in ("method", "seed", "iteration", "parameter"):
        table.add_column(heading, no_wrap=True)
    for heading in ("mean", "standard\ndeviation", "unit"):
        table.add_column(heading, justify="right")
    for row in results["estimates"]:
        numbers = (f"{row['mean']:.5g}", f"{row['std']:.2g}", row["unit"])
        place = (row["method"], str(row["seed"]), str(row["iteration"]), row["parameter"])
        table.add_row(*place, *numbers)
    return table


def comparisons_table(results: Json) -> RenderableType:
    """The difference of two methods, and the probability that a policy of one beats the other's."""
    if not results["comparisons"]:
        return Text("there are no two methods to compare yet")
    note = (
        "after the last iteration (before it has been reached: after the last that all seeds of "
        "all methods have, but for runs that failed), seed by seed; ties count "
        "half; intervals of differences need three seeds, of probabilities five"
    )
    if results["not_compared"]:
        note += f"; too few seeds of {', '.join(results['not_compared'])} have come to it"
    note += f"; {results['note']}"
    return Group(*_by_place(results["comparisons"], _pairs), Text(note, style="dim"))


def _pairs(pairs: Sequence[Json]) -> Table:
    table = Table("method", "against", box=None, padding=(0, 1, 0, 0), pad_edge=False)
    headings = (
        "iter-\nation",
        "difference",
        "95 % interval",
        "beats it with\nprobability",
        "seeds",
    )
    for heading in headings:
        table.add_column(heading, justify="right", no_wrap=True)
    for pair in pairs:
        difference = f"{round(pair['difference'], 2) + 0.0:+.2f}", _interval(pair, "difference_")
        probability = "–" if pair["low"] is None else f"{pair['probability']:.2f}"
        counts = str(pair["iteration"]), str(pair["seeds"])
        table.add_row(pair["method"], pair["other"], counts[0], *difference, probability, counts[1])
    return table


def claims_table(report: Json) -> RenderableType:
    """The paper's claims beside the results measured under one budget."""
    changed = ", ".join(f"{name} = {value}" for name, value in report["changed"].items())
    if not any(finding["evidence"] for finding in report["findings"]):
        return Text(f"preset {report['preset']}: the paper has no claim on these tasks or methods")
    table = Table("", "claim", "verdict", "measured", box=None, padding=(0, 2, 0, 0))
    for finding in report["findings"]:
        evidence = "\n".join(finding["evidence"]) or "–"
        table.add_row(finding["claim"], finding["statement"], _verdict(finding), evidence)
    title = f"preset {report['preset']}" + (f", but {changed}" if changed else "")
    return Group(Text(title, style="bold"), table)


def _verdict(finding: Json) -> str:
    needed = finding["seeds_needed"]
    return finding["verdict"] + (f"\n(about {needed} seeds)" if needed else "")


def plan_table(plan: Json) -> RenderableType:
    """The expected cost of runs."""
    table = Table("", "", box=None, padding=(0, 2, 0, 0), show_header=False)
    hours = "unknown, there are no cores" if plan["hours"] is None else in_words(plan["hours"])
    table.add_row("runs", str(plan["runs"]))
    if plan["stored"]:
        table.add_row("stages that have their results already", str(plan["stored"]))
    table.add_row("trainings, shared ones once", str(plan["trainings"]))
    table.add_row("their environment steps, at most", f"{plan['environment_steps']:,}")
    table.add_row("target transitions, at most", f"{plan['target_transitions']:,}")
    table.add_row("computing, at most", f"{in_words(plan['core_hours'])} on a core")
    table.add_row(f"time, with {plan['cores']} cores, at most", hours)
    table.add_row("policies on disk", f"{plan['policies_mb']:,.1f} MB")
    return Group(table, Text(plan["basis"], style="dim"))


def cost_table(cost: Json) -> RenderableType:
    """The cost of each kind of stage, and the utilisation of the cores."""
    table = Table("stages", box=None, padding=(0, 2, 0, 0))
    for heading in ("number", "seconds on a core", "CPU seconds\nof these", "preparing\nof these"):
        table.add_column(heading, justify="right")
    columns = ("stages", "seconds", "cpu_seconds", "preparing_seconds")
    total: Json = {name: sum(kind[name] for kind in cost["kinds"]) for name in columns}
    for kind in (*cost["kinds"], {"kind": "all", **total}):
        seconds = (f"{kind[name]:.1f}" for name in columns[1:])
        table.add_row(str(kind["kind"]), str(kind["stages"]), *seconds)
    return Group(table, *_utilisation(cost["utilisation"], cost["note"]))


def _utilisation(used: Json | None, note: str) -> list[RenderableType]:
    if used is None:
        text = (
            "no utilisation: not all runs have finished, other machines computed all of their "
            "stages, or there never was work for all cores"
        )
        return [Text(text, style="dim")]
    shares = Table("use of the cores", box=None, padding=(0, 2, 0, 0))
    shares.add_column("core seconds", justify="right")
    shares.add_column("")
    for name, meaning in USES.items():
        shares.add_row(name, f"{used[name]:.1f}", Text(meaning, style="dim"))
    shares.add_row("all", f"{sum(used[name] for name in USES):.1f}")
    headline = (
        f"useful work {used['useful']:.1%}, orchestration {used['overhead']:.1%} "
        f"of up to {used['cores']} cores in {used['seconds']:.0f} s"
    )
    return [Text(), shares, Text(headline), Text(note, style="dim")]


def candidates_table(found: Sequence["Candidate"]) -> RenderableType:
    """The candidates of a search, a row each, in the order given."""
    table = Table("settings", box=None, padding=(0, 2, 0, 0))
    for heading in ("threshold", "CPU seconds to it", "best returns"):
        table.add_column(heading, justify="right")
    table.add_column("")
    for each in found:
        errors = {trial.error for trial in each.trials if trial.error}
        table.add_row(
            ", ".join(f"{name}={json.dumps(value)}" for name, value in each.changes.items()),
            f"{each.reached} of {len(each.trials)}",
            _range(each.cpu_seconds),
            _range(each.returns),
            "; ".join(sorted(errors)),
        )
    return table


def _range(values: Sequence[float]) -> str:
    """The median of sorted values, and the least and the largest."""
    if not values:
        return "–"
    return f"{statistics.median(values):.0f} [{values[0]:.0f}, {values[-1]:.0f}]"
