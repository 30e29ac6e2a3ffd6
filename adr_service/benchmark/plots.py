"""The plots of a benchmark: rows of its tables in, a Matplotlib figure out."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from adr_service.benchmark.aggregate import ProfilePoint
from adr_service.benchmark.comparison import InferenceCost, ParameterEstimate, Row
from adr_service.benchmark.statistics import FEWEST_SEEDS
from adr_service.methods.catalogue import methods

_COLLECTOR_COLOURS = {
    "simopt": "#0072B2",
    "prior": "#666666",
    "random": "#E69F00",
    "random_matched": "#009E73",
}
_COLLECTOR_LABELS = {
    "simopt": "SimOpt's trajectories",
    "prior": "the prior's policy",
    "random": "random actions",
    "random_matched": "random actions, as many transitions (several episodes)",
}
_MOST_NAMED = 8  # parameters in a legend
_MOST_WITH_INTERVALS = 6  # methods with an interval at each iteration, or with a band
_SIDES = ("low", "high")  # of an interval
# most iterations between the points of two methods, in figures of parameters and of returns
_PARAMETERS_SPACING, _RETURNS_SPACING = 0.12, 0.06
_WIDTH = 0.6  # iterations over which all points of one iteration may spread
_AXIS_LABELS = {
    "inference_steps": "simulated control steps",
    "inference_seconds": "CPU seconds",
}


def plot_returns(rows: Sequence[Row]) -> Figure:
    """Normalised target return over iterations: variants below each other, tasks side by side.

    Of many methods, a second panel has the intervals, of the last iteration alone.
    """
    tasks = list(dict.fromkeys(row.task for row in rows))
    variants = list(dict.fromkeys(row.variant for row in rows))
    is_crowded = len(_names(rows)) > _MOST_WITH_INTERVALS
    each, height = (2, 4.0) if is_crowded else (1, 3.0)  # panels, and inches
    figure, axes = _grid(len(variants), each * len(tasks), height, sharey=True)
    for (i, variant), (j, task) in _pairs(variants, tasks):
        chosen = [row for row in rows if (row.task, row.variant) == (task, variant)]
        panels = axes[i, each * j : each * (j + 1)]
        panels[0].set_title(f"{task}, {variant}")
        if chosen:
            _returns_panel(panels[0], chosen, with_intervals=not is_crowded)
        if is_crowded:
            panels[1].set_title(f"{task}, {variant}, after the last iteration")
            _last_panel(panels[1], chosen)
    _label_returns(figure, axes, rows)
    return figure


def plot_profile(points: Sequence[ProfilePoint]) -> Figure:
    """The share of a method's policies that earn more than a return, over all tasks."""
    figure, axes = _grid(1, 1)
    axis = axes[0, 0]
    names = list(dict.fromkeys(point.method for point in points))
    for method in names:
        chosen = [point for point in points if point.method == method]
        x, colour = [point.level for point in chosen], _colour(method)
        if len(names) <= _MOST_WITH_INTERVALS:
            # fewer than three seeds have no interval, and no band
            low, high = (np.array([getattr(p, side) for p in chosen], float) for side in _SIDES)
            axis.fill_between(x, low, high, color=colour, alpha=0.15, linewidth=0)
        shares = [point.share for point in chosen]
        axis.plot(x, shares, color=colour, label=_label(method), drawstyle="steps-post")
    axis.set_xlabel("target return / reward threshold")
    axis.set_ylabel("share of policies that earn more")
    _legend(axis)
    note = "bands: 95 % bootstrap over seeds within tasks and variants, too short with few seeds"
    if len(names) > _MOST_WITH_INTERVALS:
        note = "no bands of so many methods: the figure's CSV file has them"
    figure.supxlabel(note, fontsize=7)
    return figure


def plot_collection(rows: Sequence[Row]) -> Figure:
    """Returns of offline methods by collector: a row per task, a column per method."""
    tasks = list(dict.fromkeys((row.task, row.variant) for row in rows))
    names = list(dict.fromkeys(row.method for row in rows))
    figure, axes = _grid(len(tasks), len(names), sharey=True)
    for (i, task), (j, method) in _pairs(tasks, names):
        axes[i, j].set_title(f"{_label(method)} on {', '.join(task)}")
        _collection_panel(
            axes[i, j],
            [row for row in rows if (row.task, row.variant, row.method) == (*task, method)],
        )
    _label_returns(figure, axes, rows)
    return figure


def plot_parameters(estimates: Sequence[ParameterEstimate]) -> Figure:
    """Inferred mean and standard deviation of every parameter, against the truth."""
    names = list(dict.fromkeys((e.task, e.variant, e.parameter, e.unit) for e in estimates))
    columns = min(4, len(names))
    rows = -(-len(names) // columns)
    figure = Figure(figsize=(3 * columns, 2.6 * rows), layout="constrained")
    axes = figure.subplots(rows, columns, squeeze=False).ravel()
    for axis in axes[len(names) :]:
        axis.set_axis_off()
    for axis, (task, variant, parameter, unit) in zip(axes, names, strict=False):
        key = (task, variant, parameter)
        _parameter_panel(axis, [e for e in estimates if (e.task, e.variant, e.parameter) == key])
        axis.set_title(f"{parameter} [{unit}], {task} {variant}", fontsize=8)
    figure.legend(*_labelled(axes.tolist()), frameon=False, loc="outside right upper")
    figure.supxlabel("one point per seed; bars: inferred standard deviation", fontsize=7)
    return figure


def plot_spread(estimates: Sequence[ParameterEstimate]) -> Figure:
    """Standard deviation of every parameter over iterations, mean over seeds."""
    tasks = list(dict.fromkeys((e.task, e.variant) for e in estimates))
    names = list(dict.fromkeys(e.method for e in estimates))
    figure, axes = _grid(len(tasks), len(names), sharey=True)
    most = 0
    for (i, task), (j, method) in _pairs(tasks, names):
        axes[i, j].set_title(f"{_label(method)} on {', '.join(task)}")
        chosen = [e for e in estimates if (e.task, e.variant, e.method) == (*task, method)]
        lines = _spread_panel(axes[i, j], chosen)
        most = max(most, lines)
        if j == len(names) - 1 and lines <= _MOST_NAMED:
            _legend(axes[i, j])
    for row_axes in axes:
        row_axes[0].set_ylabel("standard deviation in [0, 4]")
    note = "mean over seeds, of beliefs before draws are cut; the line at 1 is the prior's"
    if most > _MOST_NAMED:
        note += "; one line per parameter, named in this figure's CSV"
    figure.supxlabel(note, fontsize=7)
    return figure


def plot_cost(rows: Sequence[InferenceCost]) -> Figure:
    """Simulated steps and seconds of one inference over iterations."""
    tasks = list(dict.fromkeys((row.task, row.variant) for row in rows))
    figure, axes = _grid(len(tasks), len(_AXIS_LABELS))
    for (i, task), (j, measure) in _pairs(tasks, list(_AXIS_LABELS)):
        axes[i, j].set_title(", ".join(task))
        _cost_panel(axes[i, j], [row for row in rows if (row.task, row.variant) == task], measure)
    _legend(axes[0, -1], axes.ravel().tolist())
    figure.supxlabel("of one inference, without training; mean over seeds", fontsize=7)
    return figure


def _returns_panel(axis: Axes, rows: Sequence[Row], *, with_intervals: bool) -> None:
    last = max(row.iteration for row in rows)
    groups = {name: [row for row in rows if row.method == name] for name in _names(rows)}
    without_data = [name for name in groups if methods()[name].learns_from == "nothing"]
    for method in without_data:
        row, label = groups[method][0], _label(method)
        x = [0.0, max(last, 1)]
        axis.plot(x, [row.normalised_return] * 2, "--", color=_colour(method), label=label)
        if with_intervals and row.low is not None and row.high is not None:
            axis.fill_between(x, row.low, row.high, color=_colour(method), alpha=0.12, linewidth=0)
    moving = {name: chosen for name, chosen in groups.items() if name not in without_data}
    for shift, (method, chosen) in zip(_shifts(len(moving)), moving.items(), strict=True):
        # the axis counts trajectories, but these methods see full episodes
        by_returns = methods()[method].learns_from == "returns"
        label = _label(method) + (" (full episodes)" if by_returns else "")
        x = [row.iteration + shift for row in chosen]
        _line(axis, x, chosen, _colour(method), label)
        if with_intervals:
            _bars(axis, x, chosen, _colour(method))
    axis.axhline(1.0, color="black", linewidth=0.5)
    _iteration_axis(axis)


def _last_panel(axis: Axes, rows: Sequence[Row]) -> None:
    """Each method's mean and interval after its last iteration with enough seeds for an interval.

    A method with fewer seeds is shown after the last iteration that has as many of them as any.
    The label names the iteration where another method has a later one.
    """
    names = _names(rows)
    most = max((row.iteration for row in rows), default=0)
    labels: list[str] = []
    for x, method in enumerate(names):
        own = [row for row in rows if row.method == method]
        learned = [row for row in own if row.iteration > 0] or own
        enough = min(FEWEST_SEEDS, max(row.seeds for row in learned))
        counted = [row for row in learned if row.seeds >= enough]
        last = max(counted, key=lambda row: row.iteration)
        axis.plot([x], [last.normalised_return], "o", color=_colour(method), markersize=4)
        _bars(axis, [x], [last], _colour(method))
        is_without_data = methods()[method].learns_from == "nothing"
        is_behind = last.iteration < most and not is_without_data
        labels.append(_label(method) + (f" (after {last.iteration})" if is_behind else ""))
    axis.axhline(1.0, color="black", linewidth=0.5)
    axis.set_xticks(range(len(names)), labels, rotation=90, fontsize=7)


def _collection_panel(axis: Axes, rows: Sequence[Row]) -> None:
    collectors = list(dict.fromkeys(row.collector for row in rows))
    for shift, collector in zip(_shifts(len(collectors)), collectors, strict=True):
        chosen = [row for row in rows if row.collector == collector]
        x, colour = [row.iteration + shift for row in chosen], _COLLECTOR_COLOURS[collector]
        _line(axis, x, chosen, colour, _COLLECTOR_LABELS[collector])
        _bars(axis, x, chosen, colour)
    axis.axhline(1.0, color="black", linewidth=0.5)
    _iteration_axis(axis)


def _parameter_panel(axis: Axes, estimates: Sequence[ParameterEstimate]) -> None:
    """One parameter: a point with an error bar per seed, iteration, method and collector."""
    if estimates[0].truth is not None:
        axis.axhline(estimates[0].truth, color="black", linewidth=0.8, label="truth")
    series = dict.fromkeys((e.method, e.collector) for e in estimates)
    spacing = min(_PARAMETERS_SPACING, _WIDTH / len(series))
    for number, (method, collector) in enumerate(series):
        chosen = [e for e in estimates if (e.method, e.collector) == (method, collector)]
        axis.errorbar(
            np.array([e.iteration + spacing * number for e in chosen]),
            [e.mean for e in chosen],
            [e.std for e in chosen],
            fmt="o" if collector == "simopt" else "s",
            color=_colour(method),
            label=_label_of(method, collector),
            markersize=3,
            alpha=0.7,
            linewidth=0.8,
        )
    axis.set_xlabel("iteration")
    axis.xaxis.set_major_locator(MaxNLocator(integer=True))


def _spread_panel(axis: Axes, estimates: Sequence[ParameterEstimate]) -> int:
    """A line per parameter; returns how many there are."""
    names = list(dict.fromkeys(e.parameter for e in estimates))
    for name in names:
        by_iteration: dict[int, list[float]] = {}
        for estimate in estimates:
            if estimate.parameter == name:
                stds = by_iteration.setdefault(estimate.iteration, [])
                stds.append(estimate.normalised_std)
        means = [float(np.mean(stds)) for stds in by_iteration.values()]
        axis.plot(list(by_iteration), means, "o-", markersize=3, linewidth=1, label=name)
    axis.axhline(1.0, color="black", linewidth=0.5)
    axis.set_yscale("log")
    _iteration_axis(axis)
    return len(names)


def _cost_panel(axis: Axes, rows: Sequence[InferenceCost], measure: str) -> None:
    """A line per method and collector, of one of the `_AXIS_LABELS`."""
    for method, collector in dict.fromkeys((row.method, row.collector) for row in rows):
        chosen = [row for row in rows if (row.method, row.collector) == (method, collector)]
        values = [(row.iteration, getattr(row, measure)) for row in chosen]
        # BayRn simulates nothing, and only runs of a service have seconds
        points = [(x, y) for x, y in values if y]
        if points:
            style, label = "o-" if collector == "simopt" else "s:", _label_of(method, collector)
            x, y = zip(*points, strict=True)
            axis.plot(x, y, style, color=_colour(method), label=label, markersize=4)
            axis.set_yscale("log")
    axis.set_ylabel(_AXIS_LABELS[measure])
    _iteration_axis(axis)


def _names(rows: Sequence[Row]) -> list[str]:
    return list(dict.fromkeys(row.method for row in rows))


def _shifts(count: int) -> list[float]:
    """Distances of methods' points from an iteration, so that no interval hides another."""
    spacing = min(_RETURNS_SPACING, _WIDTH / max(count, 1))
    return [spacing * (number - (count - 1) / 2) for number in range(count)]


def _line(axis: Axes, x: Sequence[float], rows: Sequence[Row], colour: str, label: str) -> None:
    """A line of means."""
    means = [row.normalised_return for row in rows]
    axis.plot(x, means, "o-", color=colour, label=label, markersize=4, linewidth=1.2)


def _bars(axis: Axes, x: Sequence[float], rows: Sequence[Row], colour: str) -> None:
    """Intervals of means; fewer than three seeds have none."""
    low, high = (np.array([getattr(row, side) for row in rows], float) for side in _SIDES)
    axis.vlines(x, low, high, color=colour, linewidth=1)


def _label_returns(figure: Figure, axes: np.ndarray, rows: Sequence[Row]) -> None:
    """Axis label, legend and note of a figure of returns with their intervals."""
    for row_axes in axes:
        row_axes[0].set_ylabel("target return / reward threshold")
    _legend(axes[0, -1], axes.ravel().tolist())
    seeds = "–".join(map(str, sorted({row.seeds for row in rows})))
    has_intervals = any(row.low is not None for row in rows)
    what = "bars" if len(_names(rows)) > _MOST_WITH_INTERVALS else "bars, bands"
    drawn = f"{what}: 95 % intervals over seeds" if has_intervals else "no intervals: too few seeds"
    begun: dict[str, list[float]] = {}  # transitions seen before the first iteration, by panel
    for row in rows:
        if row.iteration == 0 and row.target_transitions > 0:
            begun.setdefault(row.method, []).append(row.target_transitions)
    before = "".join(
        f"; {_label(name)} begins at {_range(counts)} transitions" for name, counts in begun.items()
    )
    figure.supxlabel(f"{drawn} (here {seeds}){before}", fontsize=7)


def _range(counts: Sequence[float]) -> str:
    """The least and the largest of these counts, once if they are equal."""
    return " to ".join(dict.fromkeys(f"{count:,.0f}" for count in (min(counts), max(counts))))


def _grid(
    rows: int, columns: int, height: float = 3.0, **options: Any
) -> tuple[Figure, np.ndarray]:
    """A figure of panels, with room for a legend on its right: axes (rows, columns)."""
    figure = Figure(figsize=(2 + 4.2 * columns, 0.4 + height * rows), layout="constrained")
    return figure, figure.subplots(rows, columns, squeeze=False, **options)


def _legend(axis: Axes, panels: Sequence[Axes] = ()) -> None:
    """A legend beside a panel, of all that some panels show, or of its own."""
    handles, labels = _labelled(panels or [axis])
    beside: Any = {"frameon": False, "fontsize": 7, "loc": "center left"}
    axis.legend(handles, labels, bbox_to_anchor=(1, 0.5), **beside)


def _labelled(panels: Sequence[Axes]) -> tuple[list[Any], list[str]]:
    """Handles and labels of all that panels show, each label once: some panels lack methods."""
    found: dict[str, Any] = {}
    for panel in panels:
        for handle, label in zip(*panel.get_legend_handles_labels(), strict=True):
            found.setdefault(label, handle)
    return list(found.values()), list(found)


def _label(method: str) -> str:
    return methods()[method].label or method


def _label_of(method: str, collector: str) -> str:
    """The method's label, with its collector if that is not SimOpt."""
    return _label(method) + ("" if collector == "simopt" else f" on {collector}")


def _colour(method: str) -> str:
    return methods()[method].colour


def _iteration_axis(axis: Axes) -> None:
    axis.set_xlabel("iteration (target trajectories seen)")
    axis.xaxis.set_major_locator(MaxNLocator(integer=True))


def _pairs(one: Sequence[Any], other: Sequence[Any]) -> list[tuple[tuple[int, Any], ...]]:
    return [(a, b) for a in enumerate(one) for b in enumerate(other)]
