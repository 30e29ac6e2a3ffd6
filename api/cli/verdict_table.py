"""The verdict of a criticism on a terminal."""

from rich.console import Group, RenderableType
from rich.markup import escape
from rich.table import Table
from rich.text import Text

from adr_service.client import Json
from adr_service.criticism.verdict import Rest, interval_text, sure


def verdict_table(verdict: Json) -> RenderableType:
    """The verdict in words, and its causes with strengths and intervals."""
    headline = "\n".join(
        [
            f"{verdict['verdict']}, {sure(verdict['confidence'])}",
            *_warnings(verdict),
            *_gain(verdict),
            *verdict["remarks"],
        ]
    )
    if not verdict["causes"]:
        return Text(headline)
    return Group(_causes(verdict), Text(headline))


def _warnings(verdict: Json) -> list[str]:
    """Reasons to doubt the verdict."""
    lines: list[str] = []
    moved = verdict["residual"]["parameters"]
    if at_bound := ", ".join(name for name, each in moved.items() if each["at_bound"]):
        lines.append(
            f"do not rely on it: {at_bound} is at the edge of its bounds (are the order and the "
            "units of the columns the model's? are the bounds wide enough?)"
        )
    if verdict["residual"]["rest"] == "unknown":
        lines += _rest(verdict)
    return lines


def _rest(verdict: Json) -> list[str]:
    """What the named causes do not explain, and at which joint."""
    lines: list[str] = []
    if verdict["causes"]:
        lines.append("something else is missing that is none of the effects we know")
    if where := verdict["residual"].get("where"):  # stored verdicts of earlier versions lack it
        lines.append(f"what is left is best explained by {Rest(**where).words}")
    return lines


def _gain(verdict: Json) -> list[str]:
    """Gain on episodes set aside, and the time step that it was measured with."""
    gain, step = verdict["gain"], verdict["residual"].get("timestep")
    if gain is None:
        return []
    low, removed, high = (100 * gain[name] for name in ("low", "sse_removed", "high"))
    lines = [
        f"on episodes set aside, {removed:.1f} % [{low:.1f}, {high:.1f}] of the squared error "
        "one step ahead is gone (of a filter that knows the sensors' noise)"
    ]
    if step["judged_with"] < step["of_the_model"]:
        lines.append(
            f"judged at steps of {1000 * step['judged_with']:.3g} ms; extended.xml keeps the "
            f"model's {1000 * step['of_the_model']:.3g} ms"
        )
    return lines


def _causes(verdict: Json) -> Table:
    table = Table(box=None, padding=(0, 2, 0, 0))
    for heading in ("cause", "location"):  # names to copy
        table.add_column(heading, no_wrap=True)
    table.add_column("strength")
    for heading in ("value", "95 % interval", "evidence, nats"):
        table.add_column(heading, justify="right")
    for cause, tied in zip(verdict["causes"], verdict["tied"], strict=True):
        _add_cause(table, "", cause)
        for other in tied:
            _add_cause(table, "or ", other)
    return table


def _add_cause(table: Table, prefix: str, cause: Json) -> None:
    """Add a row for each strength of a cause."""
    for strength, estimate in cause["parameters"].items():
        table.add_row(
            *map(escape, (prefix + cause["kind"], cause["location"], strength)),
            escape(f"{estimate['value']:.4g} {estimate['unit']}"),
            escape(interval_text(estimate["low"], estimate["high"])),
            f"{cause['gain_nats']:.0f}",
        )
