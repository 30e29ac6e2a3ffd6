"""The figures of a benchmark, as SVG or PNG; the same outcomes give the same bytes."""

import io
import threading
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Literal

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from adr_service.benchmark.comparison import Outcome, Row, estimates, table
from adr_service.errors import InvalidInput, UnknownName

Format = Literal["svg", "png"]

# Okabe and Ito's colours, told apart by colour-blind readers; one per method everywhere
COLOURS = {
    "udr": "#E69F00",
    "bayrn": "#999933",
    "simopt": "#0072B2",
    "simopt_1": "#56B4E9",
    "droid": "#CC79A7",
    "dropo": "#D55E00",
    "sysid": "#000000",
    "prior": "#666666",
    "oracle": "#009E73",
}
LABELS = {
    "udr": "UDR",
    "bayrn": "BayRn",
    "simopt": "SimOpt",
    "simopt_1": "SimOpt-1",
    "droid": "DROID",
    "dropo": "DROPO",
    "sysid": "sysid",
    "prior": "prior",
    "oracle": "oracle",
}
_DRAWING = threading.Lock()  # Matplotlib's settings belong to the process; requests to threads
_REFERENCES = ("udr", "prior", "oracle")  # no iterations: drawn as levels


def draw(name: str, outcomes: Sequence[Outcome], file_format: Format) -> bytes:
    """One of `FIGURES`, drawn from the outcomes so far."""
    if name not in FIGURES:
        raise UnknownName("figure", name, FIGURES)
    if not outcomes:
        raise InvalidInput("there is nothing to draw yet: no iteration has finished")
    # the salt names the elements of an SVG; without it they differ from time to time
    with _DRAWING, mpl.rc_context({"svg.hashsalt": "adr", "svg.fonttype": "none", "font.size": 9}):
        figure = FIGURES[name](outcomes)
        buffer = io.BytesIO()
        metadata = {"Date": None} if file_format == "svg" else {"Software": None}
        figure.savefig(buffer, format=file_format, dpi=150, metadata=metadata)
    return buffer.getvalue()


def _returns(outcomes: Sequence[Outcome]) -> Figure:
    """Normalised target return over iterations, a panel per task and variant."""
    rows = table(outcomes)
    panels = list(dict.fromkeys((row.task, row.variant) for row in rows))
    figure = Figure(figsize=(2 + 4.2 * len(panels), 3.4), layout="constrained")
    axes = figure.subplots(1, len(panels), sharey=True, squeeze=False)[0]
    for axis, panel in zip(axes, panels, strict=True):
        _returns_panel(axis, [row for row in rows if (row.task, row.variant) == panel])
        axis.set_title(f"{panel[0]}, {panel[1]}")
    axes[0].set_ylabel("target return / reward threshold")
    axes[-1].legend(frameon=False, fontsize=7, loc="center left", bbox_to_anchor=(1, 0.5))
    seeds = sorted({row.seeds for row in rows})
    figure.supxlabel(
        f"bands: 95 % bootstrap intervals over {'–'.join(map(str, seeds))} seeds and episodes",
        fontsize=7,
    )
    return figure


def _returns_panel(axis: Axes, rows: Sequence[Row]) -> None:
    last = max(row.iteration for row in rows)
    for method in dict.fromkeys(row.method for row in rows):
        mine = [row for row in rows if row.method == method]
        if method in _REFERENCES:
            row = mine[0]
            x, style = [0.0, max(last, 1)], "--"
            mean, low, high = ([v] * 2 for v in (row.normalised_return, row.low, row.high))
        else:
            x, style = [float(row.iteration) for row in mine], "o-"
            mean = [row.normalised_return for row in mine]
            low, high = [row.low for row in mine], [row.high for row in mine]
        axis.fill_between(x, low, high, color=COLOURS[method], alpha=0.15, linewidth=0)
        axis.plot(x, mean, style, color=COLOURS[method], label=LABELS[method], markersize=4)
    axis.axhline(1.0, color="black", linewidth=0.5)
    axis.set_xlabel("iteration (target trajectories seen)")
    axis.set_xticks(range(last + 1))


def _parameters(outcomes: Sequence[Outcome]) -> Figure:
    """Inferred mean and standard deviation of every parameter, against the truth."""
    found = estimates(outcomes)
    if not found:
        raise InvalidInput("no method of this benchmark has inferred a distribution yet")
    names = list(dict.fromkeys((e.task, e.variant, e.parameter, e.unit) for e in found))
    columns = min(4, len(names))
    rows = -(-len(names) // columns)
    figure = Figure(figsize=(3 * columns, 2.6 * rows), layout="constrained")
    axes = figure.subplots(rows, columns, squeeze=False).ravel()
    for axis in axes[len(names) :]:
        axis.set_axis_off()
    for axis, (task, variant, parameter, unit) in zip(axes, names, strict=False):
        mine = [e for e in found if (e.task, e.variant, e.parameter) == (task, variant, parameter)]
        axis.axhline(mine[0].truth, color="black", linewidth=0.8, label="truth")
        for shift, method in enumerate(dict.fromkeys(e.method for e in mine)):
            chosen = [e for e in mine if e.method == method]
            x = np.array([e.iteration + 0.12 * shift for e in chosen])
            axis.errorbar(
                x,
                [e.mean for e in chosen],
                [e.std for e in chosen],
                fmt="o",
                color=COLOURS[method],
                label=LABELS[method],
                markersize=3,
                alpha=0.7,
                linewidth=0.8,
            )
        axis.set_title(f"{parameter} [{unit}], {variant}", fontsize=8)
        axis.set_xlabel("iteration")
        axis.set_xticks(sorted({e.iteration for e in mine}))
    axes[0].legend(frameon=False, fontsize=7)
    figure.supxlabel("one point per seed; bars: inferred standard deviation", fontsize=7)
    return figure


FIGURES: Mapping[str, Callable[[Sequence[Outcome]], Any]] = {
    "returns": _returns,
    "parameters": _parameters,
}
