"""The verdict of a criticism on a terminal."""

from rich.console import Group, RenderableType
from rich.table import Table
from rich.text import Text

from adr_service.client import Json
from adr_service.criticism.verdict import interval_text, quantity_text
from api.verdicts import told


def verdict_table(verdict: Json) -> RenderableType:
    """The verdict in words, and its causes with strengths and intervals."""
    headline = "\n".join(told(verdict))
    if not verdict["causes"]:
        return Text(headline)
    return Group(_causes(verdict), Text(headline))


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
            prefix + cause["kind"],
            cause["location"],
            strength,
            quantity_text(estimate["value"], estimate["unit"]),
            interval_text(estimate["low"], estimate["high"]),
            f"{cause['gain_nats']:.0f}",
        )
