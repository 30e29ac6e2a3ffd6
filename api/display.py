"""Progress and results on a terminal."""

from collections.abc import Iterable, Sequence
from typing import Any

from rich.console import Console, Group, RenderableType
from rich.live import Live
from rich.markup import escape
from rich.progress_bar import ProgressBar
from rich.table import Table
from rich.text import Text

from adr_service.criticism.verdict import sure
from adr_service.json_values import printable
from api.client import AdrClient, Json, is_finished

_REPORT_EVERY = 20  # looks, where the output is not a terminal


def live(console: Console, client: AdrClient, id: str) -> Json:
    """Show progress until the run or benchmark has finished; its last state."""
    seen: Json = {}
    if not console.is_terminal:
        for look, seen in enumerate(client.watch(id)):
            if look % _REPORT_EVERY == 0 or is_finished(seen):
                console.print(headline(seen), highlight=False, soft_wrap=True)
        return seen
    with Live(console=console, refresh_per_second=4) as screen:
        for seen in client.watch(id):
            screen.update(_progress(seen))
    return seen


def results_table(results: Json) -> RenderableType:
    """The result table with its intervals."""
    table = Table(box=None, padding=(0, 1, 0, 0))
    for heading in ("task", "variant", "method"):
        table.add_column(heading, overflow="fold")
    for heading in (
        *("iteration", "return /\nthreshold", "95 %\ninterval", "seeds", "episodes"),
        *("target\ntransitions", "distance\nfrom truth", "posterior\nstd"),
    ):
        whole = heading.endswith("interval")
        table.add_column(heading, justify="right", overflow="fold", no_wrap=whole)
    for row in results["rows"]:
        error, std = row["estimation_error"], row["posterior_std"]
        whose = "" if row["collector"] == "simopt" else f" on {row['collector']}"
        table.add_row(
            row["task"],
            row["variant"],
            row["method"] + whose,
            str(row["iteration"]),
            f"{row['normalised_return']:.2f}",
            f"[{row['low']:.2f}, {row['high']:.2f}]".replace("[", r"\["),
            str(row["seeds"]),
            str(row["episodes"]),
            f"{row['target_transitions']:.0f}",
            "–" if error is None else f"{error:.2f}",
            "–" if std is None else f"{std:.2g}",
        )
    if results["rows"]:
        return Group(table, Text(results["note"], style="dim"))
    if results["estimates"]:
        return Group(estimates_table(results), Text(results["note"], style="dim"))
    return Text("no iteration has finished yet")


def plan_table(plan: Json) -> RenderableType:
    """What runs would cost."""
    table = Table("", "", box=None, padding=(0, 2, 0, 0), show_header=False)
    hours = "unknown, there are no cores" if plan["hours"] is None else _duration(plan["hours"])
    table.add_row("runs", str(plan["runs"]))
    table.add_row("trainings, shared ones once", str(plan["trainings"]))
    table.add_row("their environment steps, at most", f"{plan['environment_steps']:,}")
    table.add_row("target transitions, at most", f"{plan['target_transitions']:,}")
    table.add_row("computing", f"{_duration(plan['core_hours'])} on a core")
    table.add_row(f"time, with {plan['cores']} cores", hours)
    table.add_row("policies on disk", f"{plan['policies_mb']:.2g} MB")
    return Group(table, Text(plan["basis"], style="dim"))


def _duration(hours: float) -> str:
    """What is much less than a minute is mostly the start of processes, which no plan counts."""
    if hours < 1 / 60:
        return "less than a minute"
    return f"{60 * hours:.0f} minutes" if hours < 1 else f"{hours:.2g} hours"


def failures(seen: Json) -> list[str]:
    """Why runs failed, a line each."""
    return [
        f"{run['id']} failed: {printable(run['error']['message'])}".replace("\n", "\n    ")
        for run in _runs(seen)
        if run["error"]
    ]


def estimates_table(results: Json) -> RenderableType:
    """What was inferred, by parameter."""
    table = Table("method", "seed", "iteration", "parameter", box=None, padding=(0, 2, 0, 0))
    for heading in ("mean", "standard deviation", "unit"):
        table.add_column(heading, justify="right")
    for found in results["estimates"]:
        numbers = (f"{found['mean']:.5g}", f"{found['std']:.2g}", found["unit"])
        table.add_row(
            found["method"],
            str(found["seed"]),
            str(found["iteration"]),
            found["parameter"],
            *numbers,
        )
    return table


def claims_table(report: Json) -> RenderableType:
    """The paper's claims against what was measured under one budget."""
    changed = ", ".join(f"{name} = {value}" for name, value in report["changed"].items())
    table = Table("", "claim", "verdict", "measured", box=None, padding=(0, 2, 0, 0))
    for finding in report["findings"]:
        evidence = "\n".join(finding["evidence"]) or "–"
        cells = (finding["claim"], finding["statement"], finding["verdict"], evidence)
        table.add_row(*map(escape, cells))
    title = f"preset {report['preset']}" + (f", but {changed}" if changed else "")
    return Group(Text(title, style="bold"), table)


def comparisons_table(results: Json) -> RenderableType:
    """How often a policy of one method beats one of another."""
    table = Table("task", "variant", "method", "beats", box=None, padding=(0, 2, 0, 0))
    for heading in ("probability", "95 % interval", "seeds"):
        table.add_column(heading, justify="right")
    for pair in results["comparisons"]:
        table.add_row(
            pair["task"],
            pair["variant"],
            pair["method"],
            pair["other"],
            f"{pair['probability']:.2f}",
            f"[{pair['low']:.2f}, {pair['high']:.2f}]".replace("[", r"\["),
            str(pair["seeds"]),
        )
    if not results["comparisons"]:
        return Text("there are no two methods to compare yet")
    return Group(table, Text("after each method's last iteration; ties count half", style="dim"))


def cost_table(cost: Json) -> RenderableType:
    """What stages cost, and how busy the cores were."""
    table = Table("stages", box=None, padding=(0, 2, 0, 0))
    for heading in ("number", "seconds on a core", "CPU seconds", "preparing"):
        table.add_column(heading, justify="right")
    for kind in cost["kinds"]:
        numbers = (kind["seconds"], kind["cpu_seconds"], kind["preparing_seconds"])
        cells = (f"{number:.1f}" for number in numbers)
        table.add_row(kind["kind"], str(kind["stages"]), *cells)
    found = cost["utilisation"]
    if found is None:
        told = "utilisation: told once all has finished, where there was work for all cores at once"
        return Group(table, Text(told, style="dim"))
    shares = Table("core seconds", "", box=None, padding=(0, 2, 0, 0))
    for name in ("computing", "waiting", "orchestration", "starting", "preparing"):
        shares.add_row(name, f"{found[name]:.1f}")
    headline = (
        f"useful work {found['useful']:.1%}, orchestration {found['overhead']:.1%} "
        f"of {found['cores']} cores in {found['seconds']:.0f} s"
    )
    return Group(table, Text(), shares, Text(headline), Text(cost["note"], style="dim"))


def verdict_table(verdict: Json) -> RenderableType:
    """What a criticism named, with strengths and their intervals."""
    lines = [f"{verdict['verdict']}, {sure(verdict['confidence'])}"]
    moved, gain = verdict["residual"]["parameters"], verdict["gain"]
    if at_bound := ", ".join(name for name, each in moved.items() if each["at_bound"]):
        lines.append(
            f"not to be relied on: {at_bound} at the edge of what may be (are the columns' order "
            "and units the model's? are the bounds wide enough?)"
        )
    if verdict["residual"]["rest"] == "unknown" and verdict["causes"]:
        lines.append("something else is missing that is none of the effects we know")
    if gain is not None:
        low, removed, high = (100 * gain[name] for name in ("low", "sse_removed", "high"))
        lines.append(
            f"on episodes set aside, {removed:.1f} % [{low:.1f}, {high:.1f}] of the squared error "
            "one step ahead is gone (of a filter that knows the sensors' noise)"
        )
        step = verdict["residual"]["timestep"]
        if step["judged_with"] < step["of_the_model"]:
            lines.append(
                f"judged at steps of {1000 * step['judged_with']:.3g} ms; extended.xml keeps the "
                f"model's {1000 * step['of_the_model']:.3g} ms"
            )
    headline = "\n".join([*lines, *verdict["remarks"]])
    table = Table(box=None, padding=(0, 2, 0, 0))
    for heading in ("cause", "location"):  # names to copy
        table.add_column(heading, no_wrap=True)
    table.add_column("strength")
    for heading in ("value", "95 % interval", "evidence, nats"):
        table.add_column(heading, justify="right")
    for cause, tied in zip(verdict["causes"], verdict["tied"], strict=True):
        for prefix, named in [("", cause), *(("or ", other) for other in tied)]:
            for strength, found in named["parameters"].items():
                table.add_row(
                    *map(escape, (prefix + named["kind"], named["location"], strength)),
                    escape(f"{found['value']:.4g} {found['unit']}"),
                    escape(_interval(found)),
                    f"{named['gain_nats']:.0f}",
                )
    return Group(table, Text(headline)) if verdict["causes"] else Text(headline)


def _interval(found: Json) -> str:
    if found["high"] is None:
        return "cannot be told"
    low = "-∞" if found["low"] is None else f"{found['low']:.4g}"
    return f"{low} to {found['high']:.4g}"


def trials_table(trials: Sequence[Json]) -> RenderableType:
    """The trials of a search, the best first."""
    table = Table("learning rate", "seed", box=None, padding=(0, 2, 0, 0))
    for heading in ("steps", "best return", "threshold"):
        table.add_column(heading, justify="right")
    table.add_column("")
    for trial in trials:
        table.add_row(
            f"{trial['learning_rate']:g}",
            str(trial["seed"]),
            f"{trial['steps']:,}",
            "–" if trial["best_return"] is None else f"{trial['best_return']:.0f}",
            "reached" if trial["reached_threshold"] else "–",
            escape(trial["error"] or "") or ("stopped early" if trial["stopped_early"] else ""),
        )
    return table


def _runs(seen: Json) -> list[Json]:
    return seen.get("runs", [seen])


def label(spec: Json) -> str:
    """What a run does, in a word."""
    return spec["method"]["name"] if "method" in spec else spec["kind"]


def headline(seen: Json) -> str:
    runs = _runs(seen)
    finished = sum(run["state"] == "succeeded" for run in runs)
    stages = _stages(runs)
    running = [
        f"{label(run['spec'])}/{run['spec']['seed']} {stage['kind']} {stage['fraction']:.0%}"
        for run, stage in stages
        if stage["state"] == "running"
    ]
    waiting = [(run, stage["kind"]) for run, stage in stages if stage["state"] == "waiting"]
    robots = [run["spec"]["task"] for run, kind in waiting if kind == "target_episode"]
    cores = len(waiting) - len(robots)
    broken = {run["state"] for run in runs} & {"failed", "cancelled"}
    return (
        f"{finished}/{len(runs)} runs done"
        + (f", others {' and '.join(sorted(broken))}" if broken else "")
        + (f"; now {', '.join(running)}" if running else "")
        + (f"; {cores} stages wait for a core" if cores else "")
        + (f"; {len(robots)} episodes wait for a robot of {_listed(robots)}" if robots else "")
    )


def _listed(names: Iterable[str]) -> str:
    return ", ".join(sorted(set(names)))


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


def _stages(runs: Iterable[Json]) -> list[tuple[Json, dict[str, Any]]]:
    """(run, stage) of what is in the works; a stage that runs share is told once."""
    told: dict[str, tuple[Json, dict[str, Any]]] = {}
    for run in runs:
        for stage in run["progress"]:
            told.setdefault(stage["digest"], (run, stage))
    return list(told.values())
