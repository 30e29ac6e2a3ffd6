"""The figures of a benchmark as SVG or PNG, and their numbers as CSV.

    draw("returns", outcomes, "svg")            # or "returns-noisy": one variant alone

The same outcomes give the same bytes.
"""

import io
import threading
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal

import matplotlib as mpl
from matplotlib.figure import Figure

from adr_service.benchmark.aggregate import ProfilePoint, has_common_cells, profiles
from adr_service.benchmark.comparison import (
    InferenceCost,
    Outcome,
    ParameterEstimate,
    Row,
    costs,
    decode,
    estimates,
    table,
    to_csv,
)
from adr_service.benchmark.plots import (
    plot_collection,
    plot_cost,
    plot_parameters,
    plot_profile,
    plot_returns,
    plot_spread,
)
from adr_service.errors import InvalidInput, UnknownName

Format = Literal["svg", "png", "csv"]

_DRAWING = threading.Lock()  # Matplotlib's settings belong to the process, requests to threads


def draw(name: str, outcomes: Sequence[Outcome], file_format: Format) -> bytes:
    """One of `FIGURES`, drawn from the outcomes so far, or its numbers as CSV."""
    base, _, variant = name.partition("-")
    if base not in FIGURES:
        raise UnknownName("figure", name, FIGURES)
    if variant and variant not in _variants(outcomes):
        raise UnknownName(f"variant for the figure {base}", variant, _variants(outcomes))
    kind = FIGURES[base]
    rows = kind.rows([o for o in outcomes if variant in {"", o.spec.variant}])
    if file_format == "csv":
        return to_csv(rows, kind.row_type).encode()
    if not rows:
        raise InvalidInput(f"there is nothing to draw yet: {kind.lacking}")
    # without a fixed salt, the names of an SVG's elements change from call to call
    with _DRAWING, mpl.rc_context({"svg.hashsalt": "adr", "svg.fonttype": "none", "font.size": 9}):
        buffer = io.BytesIO()
        metadata = {"Date": None} if file_format == "svg" else {"Software": None}
        kind.draw(rows).savefig(buffer, format=file_format, dpi=150, metadata=metadata)
    return buffer.getvalue()


def drawable(outcomes: Sequence[Outcome]) -> list[str]:
    """Names of the figures with something to draw; the returns once per variant."""
    names = [
        name
        for name, kind in FIGURES.items()
        if any(map(kind.is_drawn, outcomes)) and kind.is_complete(outcomes)
    ]
    shown = _variants([outcome for outcome in outcomes if _in_the_protocol(outcome)])
    by_variant = [f"returns-{variant}" for variant in shown]
    if "returns" in names and len(by_variant) > 1:
        names[names.index("returns") : names.index("returns") + 1] = by_variant
    return names


def _variants(outcomes: Sequence[Outcome]) -> list[str]:
    return list(dict.fromkeys(outcome.spec.variant for outcome in outcomes))


def _in_the_protocol(outcome: Outcome) -> bool:
    return bool(outcome.iteration.returns) and outcome.spec.collector == "simopt"


def _by_others(outcome: Outcome) -> bool:
    return bool(outcome.iteration.returns) and outcome.spec.collector != "simopt"


def _has_spread(outcome: Outcome) -> bool:
    """True if the outcome is of the protocol and its belief is no point (as sysid's is)."""
    inferred = bool(outcome.iteration.inferences) and outcome.is_inferred
    return inferred and outcome.spec.collector == "simopt" and bool(decode(outcome)[0].std.any())


def _protocol_rows(outcomes: Sequence[Outcome]) -> list[Row]:
    return table([outcome for outcome in outcomes if _in_the_protocol(outcome)])


def _collection_rows(outcomes: Sequence[Outcome]) -> list[Row]:
    """Rows of the methods that learnt from the data of several collectors."""

    def column(outcome: Outcome) -> tuple[str, str, str]:
        return outcome.spec.task, outcome.spec.variant, outcome.spec.method.name

    studied = {column(outcome) for outcome in outcomes if _by_others(outcome)}
    return table([outcome for outcome in outcomes if column(outcome) in studied])


def _spread_rows(outcomes: Sequence[Outcome]) -> list[ParameterEstimate]:
    """Estimates of the methods that infer a spread, from the prior on."""
    names = {outcome.spec.method.name for outcome in outcomes if _has_spread(outcome)}
    return estimates(
        [o for o in outcomes if o.spec.method.name in names and o.spec.collector == "simopt"]
    )


@dataclass(frozen=True)
class Kind:
    """A kind of figure: its rows and its plot."""

    caption: str
    is_drawn: Callable[[Outcome], bool]  # true if the outcome adds something to the figure
    row_type: type
    rows: Callable[[Sequence[Outcome]], Sequence[Any]]
    draw: Callable[[Any], Figure]
    lacking: str  # reason for an empty figure
    is_complete: Callable[[Sequence[Outcome]], bool] = lambda outcomes: True  # enough for the rows


FIGURES: Mapping[str, Kind] = {
    "returns": Kind(
        "Target return over iterations",
        _in_the_protocol,
        Row,
        _protocol_rows,
        plot_returns,
        "no iteration on SimOpt's data has been evaluated",
    ),
    "profile": Kind(
        "Performance profile: policies that earn more than a return, over the tasks and variants "
        "that most methods have; methods that lack one are left out",
        _in_the_protocol,
        ProfilePoint,
        profiles,
        plot_profile,
        "no task's variant was evaluated by all methods",
        has_common_cells,
    ),
    "collection": Kind(
        "Target return by who collected the data",
        _by_others,
        Row,
        _collection_rows,
        plot_collection,
        "nobody but SimOpt has collected",
    ),
    "parameters": Kind(
        "Inferred parameters against the truth",
        lambda outcome: outcome.is_inferred,
        ParameterEstimate,
        estimates,
        plot_parameters,
        "no method has inferred a distribution",
    ),
    "spread": Kind(
        "Standard deviation of the inferred distributions",
        _has_spread,
        ParameterEstimate,
        _spread_rows,
        plot_spread,
        "no method has inferred a distribution with a spread",
    ),
    "cost": Kind(
        "Cost of the inferences",
        lambda outcome: bool(outcome.iteration.inferences),
        InferenceCost,
        costs,
        plot_cost,
        "no method has inferred anything",
    ),
}

CAPTIONS: Mapping[str, str] = {name: kind.caption for name, kind in FIGURES.items()}
