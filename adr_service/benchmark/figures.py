"""The figures of a benchmark, as SVG or PNG, and as CSV what they draw.

    draw("returns", outcomes, "svg")            # or "returns-noisy": one variant alone

The same outcomes give the same bytes.
"""

import io
import threading
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from adr_service.benchmark.comparison import (
    Cost,
    Outcome,
    ParameterEstimate,
    Row,
    costs,
    decode,
    estimates,
    table,
    to_csv,
)
from adr_service.errors import InvalidInput, UnknownName
from adr_service.methods.catalogue import methods

Format = Literal["svg", "png", "csv"]

_COLLECTOR_COLOURS = {"simopt": "#0072B2", "prior": "#666666", "random": "#E69F00"}
_COLLECTOR_LABELS = {
    "simopt": "SimOpt's trajectories",
    "prior": "the prior's policy",
    "random": "random actions",
}
_DRAWING = threading.Lock()  # Matplotlib's settings belong to the process; requests to threads
_MOST_NAMED = 8  # parameters in a legend


def draw(name: str, outcomes: Sequence[Outcome], file_format: Format) -> bytes:
    """One of `FIGURES`, drawn from the outcomes so far, or the numbers that it draws."""
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
    # the salt names the elements of an SVG; without it they differ from time to time
    with _DRAWING, mpl.rc_context({"svg.hashsalt": "adr", "svg.fonttype": "none", "font.size": 9}):
        buffer = io.BytesIO()
        metadata = {"Date": None} if file_format == "svg" else {"Software": None}
        kind.draw(rows).savefig(buffer, format=file_format, dpi=150, metadata=metadata)
    return buffer.getvalue()


def drawable(outcomes: Sequence[Outcome]) -> list[str]:
    """Names of the figures that these outcomes fill; the returns once per variant."""
    names = [name for name, kind in FIGURES.items() if any(map(kind.is_drawn, outcomes))]
    by_variant = [f"returns-{variant}" for variant in _variants(outcomes)]
    if "returns" in names and len(by_variant) > 1:
        names[names.index("returns") : names.index("returns") + 1] = by_variant
    return names


def _variants(outcomes: Sequence[Outcome]) -> list[str]:
    return list(dict.fromkeys(outcome.spec.variant for outcome in outcomes))


def _grid(rows: int, columns: int, **options: Any) -> tuple[Figure, np.ndarray]:
    """A figure of panels, with room for a legend on its right: axes (rows, columns)."""
    figure = Figure(figsize=(2 + 4.2 * columns, 0.4 + 3 * rows), layout="constrained")
    return figure, figure.subplots(rows, columns, squeeze=False, **options)


def _legend(axis: Axes) -> None:
    axis.legend(frameon=False, fontsize=7, loc="center left", bbox_to_anchor=(1, 0.5))


def _label(method: str) -> str:
    return methods()[method].label or method


def _colour(method: str) -> str:
    return methods()[method].colour


def _iteration_axis(axis: Axes, last: int) -> None:
    axis.set_xlabel("iteration (target trajectories seen)")
    axis.set_xticks(range(last + 1))


def _in_the_protocol(outcome: Outcome) -> bool:
    return bool(outcome.iteration.returns) and outcome.spec.collector == "simopt"


def _by_others(outcome: Outcome) -> bool:
    return bool(outcome.iteration.returns) and outcome.spec.collector != "simopt"


def _has_spread(outcome: Outcome) -> bool:
    """In the protocol; a point estimate (sysid) has none."""
    inferred = bool(outcome.iteration.inferences) and outcome.spec.method.infers
    return inferred and outcome.spec.collector == "simopt" and bool(decode(outcome)[0].std.any())


def _protocol_rows(outcomes: Sequence[Outcome]) -> list[Row]:
    return table([outcome for outcome in outcomes if _in_the_protocol(outcome)])


def _returns(rows: Sequence[Row]) -> Figure:
    """Normalised target return over iterations: variants below each other, tasks side by side."""
    tasks = list(dict.fromkeys(row.task for row in rows))
    variants = list(dict.fromkeys(row.variant for row in rows))
    figure, axes = _grid(len(variants), len(tasks), sharey=True)
    for (i, variant), (j, task) in _pairs(variants, tasks):
        mine = [row for row in rows if (row.task, row.variant) == (task, variant)]
        axes[i, j].set_title(f"{task}, {variant}")
        if mine:
            _returns_panel(axes[i, j], mine)
    for row_axes in axes:
        row_axes[0].set_ylabel("target return / reward threshold")
    _legend(axes[0, -1])
    _explain_bands(figure, rows)
    return figure


def _returns_panel(axis: Axes, rows: Sequence[Row]) -> None:
    last = max(row.iteration for row in rows)
    for method in dict.fromkeys(row.method for row in rows):
        mine = [row for row in rows if row.method == method]
        if methods()[method].is_level:
            mine, x, style = [mine[0]] * 2, [0.0, max(last, 1)], "--"
        else:
            x, style = [float(row.iteration) for row in mine], "o-"
        _band(axis, x, mine, style, _colour(method), _label(method))
    axis.axhline(1.0, color="black", linewidth=0.5)
    _iteration_axis(axis, last)


def _band(
    axis: Axes, x: Sequence[float], rows: Sequence[Row], style: str, colour: str, label: str
) -> None:
    low, high = [row.low for row in rows], [row.high for row in rows]
    axis.fill_between(x, low, high, color=colour, alpha=0.15, linewidth=0)
    means = [row.normalised_return for row in rows]
    axis.plot(x, means, style, color=colour, label=label, markersize=4)


def _explain_bands(figure: Figure, rows: Sequence[Row]) -> None:
    seeds = "–".join(map(str, sorted({row.seeds for row in rows})))
    figure.supxlabel(
        f"bands: 95 % bootstrap intervals over seeds (here {seeds}) and episodes", fontsize=7
    )


def _collection_rows(outcomes: Sequence[Outcome]) -> list[Row]:
    """Rows of the methods for which several collected."""

    def column(outcome: Outcome) -> tuple[str, str, str]:
        return outcome.spec.task, outcome.spec.variant, outcome.spec.method.name

    studied = {column(outcome) for outcome in outcomes if _by_others(outcome)}
    return table([outcome for outcome in outcomes if column(outcome) in studied])


def _collection(rows: Sequence[Row]) -> Figure:
    """What an offline method makes of whose data: a row per task, a column per method."""
    tasks = list(dict.fromkeys((row.task, row.variant) for row in rows))
    methods = list(dict.fromkeys(row.method for row in rows))
    figure, axes = _grid(len(tasks), len(methods), sharey=True)
    for (i, task), (j, method) in _pairs(tasks, methods):
        axis = axes[i, j]
        axis.set_title(f"{_label(method)} on {', '.join(task)}")
        mine = [row for row in rows if (row.task, row.variant, row.method) == (*task, method)]
        for collector in dict.fromkeys(row.collector for row in mine):
            chosen = [row for row in mine if row.collector == collector]
            x, colour = [row.iteration for row in chosen], _COLLECTOR_COLOURS[collector]
            _band(axis, x, chosen, "o-", colour, _COLLECTOR_LABELS[collector])
        axis.axhline(1.0, color="black", linewidth=0.5)
        _iteration_axis(axis, max((row.iteration for row in mine), default=0))
    for row_axes in axes:
        row_axes[0].set_ylabel("target return / reward threshold")
    _legend(axes[0, -1])
    _explain_bands(figure, rows)
    return figure


def _parameters(found: Sequence[ParameterEstimate]) -> Figure:
    """Inferred mean and standard deviation of every parameter, against the truth."""
    names = list(dict.fromkeys((e.task, e.variant, e.parameter, e.unit) for e in found))
    columns = min(4, len(names))
    rows = -(-len(names) // columns)
    figure = Figure(figsize=(3 * columns, 2.6 * rows), layout="constrained")
    axes = figure.subplots(rows, columns, squeeze=False).ravel()
    for axis in axes[len(names) :]:
        axis.set_axis_off()
    for axis, (task, variant, parameter, unit) in zip(axes, names, strict=False):
        mine = [e for e in found if (e.task, e.variant, e.parameter) == (task, variant, parameter)]
        if mine[0].truth is not None:
            axis.axhline(mine[0].truth, color="black", linewidth=0.8, label="truth")
        for shift, (method, collector) in enumerate(
            dict.fromkeys((e.method, e.collector) for e in mine)
        ):
            chosen = [e for e in mine if (e.method, e.collector) == (method, collector)]
            x = np.array([e.iteration + 0.12 * shift for e in chosen])
            axis.errorbar(
                x,
                [e.mean for e in chosen],
                [e.std for e in chosen],
                fmt="o" if collector == "simopt" else "s",
                color=_colour(method),
                label=_label(method) + ("" if collector == "simopt" else f" on {collector}"),
                markersize=3,
                alpha=0.7,
                linewidth=0.8,
            )
        axis.set_title(f"{parameter} [{unit}], {task} {variant}", fontsize=8)
        axis.set_xlabel("iteration")
        axis.set_xticks(sorted({e.iteration for e in mine}))
    axes[0].legend(frameon=False, fontsize=7)
    figure.supxlabel("one point per seed; bars: inferred standard deviation", fontsize=7)
    return figure


def _spread_rows(outcomes: Sequence[Outcome]) -> list[ParameterEstimate]:
    """Estimates of methods that give a spread, from the prior's on."""
    methods = {outcome.spec.method.name for outcome in outcomes if _has_spread(outcome)}
    return estimates(
        [o for o in outcomes if o.spec.method.name in methods and o.spec.collector == "simopt"]
    )


def _spread(found: Sequence[ParameterEstimate]) -> Figure:
    """Standard deviation of every parameter over iterations, mean over seeds."""
    tasks = list(dict.fromkeys((e.task, e.variant) for e in found))
    methods = list(dict.fromkeys(e.method for e in found))
    figure, axes = _grid(len(tasks), len(methods), sharey=True)
    for (i, task), (j, method) in _pairs(tasks, methods):
        axis = axes[i, j]
        axis.set_title(f"{_label(method)} on {', '.join(task)}")
        mine = [e for e in found if (e.task, e.variant, e.method) == (*task, method)]
        names = list(dict.fromkeys(e.parameter for e in mine))
        for name in names:
            by_iteration: dict[int, list[float]] = {}
            for e in mine:
                if e.parameter == name:
                    by_iteration.setdefault(e.iteration, []).append(e.normalised_std)
            means = [float(np.mean(values)) for values in by_iteration.values()]
            axis.plot(list(by_iteration), means, "o-", markersize=3, linewidth=1, label=name)
        axis.axhline(1.0, color="black", linewidth=0.5)
        axis.set_yscale("log")
        _iteration_axis(axis, max((e.iteration for e in mine), default=0))
        if j == len(methods) - 1 and len(names) <= _MOST_NAMED:
            _legend(axis)
    for row_axes in axes:
        row_axes[0].set_ylabel("standard deviation in [0, 4]")
    figure.supxlabel("mean over seeds; the line at 1 is the prior's", fontsize=7)
    return figure


def _cost(rows: Sequence[Cost]) -> Figure:
    """Simulated steps and seconds of one inference over iterations."""
    tasks = list(dict.fromkeys((row.task, row.variant) for row in rows))
    figure, axes = _grid(len(tasks), 2)
    for (i, task), (j, measure) in _pairs(tasks, ["inference_steps", "inference_seconds"]):
        axis, mine = axes[i, j], [row for row in rows if (row.task, row.variant) == task]
        axis.set_title(f"{task[0]}, {task[1]}")
        for method, collector in dict.fromkeys((row.method, row.collector) for row in mine):
            chosen = [row for row in mine if (row.method, row.collector) == (method, collector)]
            points = [(row.iteration, getattr(row, measure)) for row in chosen]
            # BayRn simulates nothing, and seconds are known of a service's runs alone
            drawn = [(x, y) for x, y in points if y]
            if drawn:
                style = "o-" if collector == "simopt" else "s:"
                label = _label(method) + ("" if collector == "simopt" else f" on {collector}")
                x, y = zip(*drawn, strict=True)
                axis.plot(x, y, style, color=_colour(method), label=label, markersize=4)
                axis.set_yscale("log")
        axis.set_ylabel(
            "simulated control steps" if measure == "inference_steps" else "seconds on one core"
        )
        _iteration_axis(axis, max(row.iteration for row in mine))
    _legend(axes[0, -1] if axes[0, -1].lines else axes[0, 0])
    figure.supxlabel("of one inference, without training; mean over seeds", fontsize=7)
    return figure


def _pairs(one: Sequence[Any], other: Sequence[Any]) -> list[tuple[tuple[int, Any], ...]]:
    return [(a, b) for a in enumerate(one) for b in enumerate(other)]


@dataclass(frozen=True)
class Kind:
    """What a figure draws, and how."""

    caption: str
    is_drawn: Callable[[Outcome], bool]  # whether an outcome gives the figure something to show
    row_type: type
    rows: Callable[[Sequence[Outcome]], Sequence[Any]]
    draw: Callable[[Any], Figure]
    lacking: str  # said where there are no rows


FIGURES: Mapping[str, Kind] = {
    "returns": Kind(
        "Target return over iterations",
        _in_the_protocol,
        Row,
        _protocol_rows,
        _returns,
        "no iteration has been evaluated",
    ),
    "collection": Kind(
        "Target return by who collected the data",
        _by_others,
        Row,
        _collection_rows,
        _collection,
        "nobody but SimOpt has collected",
    ),
    "parameters": Kind(
        "Inferred parameters against the truth",
        lambda outcome: outcome.spec.method.infers,
        ParameterEstimate,
        estimates,
        _parameters,
        "no method has inferred a distribution",
    ),
    "spread": Kind(
        "Standard deviation of the inferred distributions",
        _has_spread,
        ParameterEstimate,
        _spread_rows,
        _spread,
        "no method has inferred a distribution with a spread",
    ),
    "cost": Kind(
        "Cost of the inferences",
        lambda outcome: bool(outcome.iteration.inferences),
        Cost,
        costs,
        _cost,
        "no method has inferred anything",
    ),
}
