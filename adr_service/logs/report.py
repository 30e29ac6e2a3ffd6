"""A page about a conversion: what was read, what was left out, and what the data could show."""

from collections.abc import Sequence
from html import escape
from typing import Any

import mujoco
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from adr_service.arrays import Indices, Vector
from adr_service.criticism.compatibility import commanded_actuators, joints_of
from adr_service.criticism.decision import THRESHOLD
from adr_service.criticism.excitation import Excitation
from adr_service.criticism.page import page, svg, table
from adr_service.logs.conversion import Column, Converted, Record
from adr_service.logs.mapping import is_slide

_AT_REST = 0.02  # of a joint's largest speed
_MOST_GAPS, _MOST_POINTS = 10, 4000  # listed; drawn in a panel
_NOTICED = 0.001  # share of rows at a limit
_NEVER = 1e3  # times the sensible size
_RESAMPLING = {
    "parabola": "parabola through the readings of each row",
    "spline": "cubic spline through all readings",
    "hold": "held until the next",
    "line": "straight lines between readings",
}
_SCATTER = (
    "<p>Scatter: how far readings lie from the curve through their neighbours, as a deviation. It "
    "is the sensor's noise, and what moves between readings. Compare it with the noise that you "
    "expect: if it is much larger, a command jumps with the readings, or the log is too slow.</p>"
)
_FORCES = (
    "<p>The last column is the force that the joint's motion takes by the model, per force of "
    "its drives: 1 if the model and the map are right, less with friction, negative if a sign is "
    "wrong. It is not compared for a joint without a drive, nor while the robot touches "
    "something.</p>"
)
_POSITION, _VELOCITY, _COMMAND = "#0072B2", "#009E73", "#D55E00"  # Okabe and Ito
_INFERRED = "#999999"


def report_page(
    converted: Converted, shown: Sequence[Excitation], model: mujoco.MjModel, name: str
) -> str:
    """HTML with its figures inside; `name` is what was converted."""
    parts = [f'<p class="finding">{_summary(converted)}</p>']
    parts += [f"<p><b>Look at this:</b> {escape(each)}.</p>" for each in converted.warnings]
    parts.append(_motion(converted, model))
    parts += [svg(_traces(converted, model)), _limits(converted)]
    parts.append("<h2>What the data could show</h2>" + _shown(shown))
    parts += ["<h2>What was read</h2>", *(_read(record) for record in converted.records)]
    return page(f"Measured: {name}", parts)


def _summary(converted: Converted) -> str:
    data = converted.measurement
    lengths = [last - first for first, last in data.spans()]
    left_out = sum(record.seconds_left_out for record in converted.records)
    reach = f"{min(lengths)} to {max(lengths)}" if min(lengths) < max(lengths) else f"{lengths[0]}"
    return (
        f"{len(lengths)} episodes of {reach} rows, {1000 * converted.period:g} ms apart: "
        f"{len(data.time) - len(lengths)} transitions. {left_out:.3g} s of "
        f"{sum(record.seconds for record in converted.records):.3g} s were left out, in gaps and "
        "at ends."
    )


def _motion(converted: Converted, model: mujoco.MjModel) -> str:
    """A table of the motion of each joint."""
    data = converted.measurement
    slopes = {each.joint: f"{each.slope:.2f} ± {each.error:.2f}" for each in converted.agreements}
    rows: list[list[Any]] = []
    for number, name in enumerate(joints_of(model)):
        speed = data.qvel[:, number]
        unit = "m" if is_slide(model, name) else "rad"
        fastest = float(np.abs(speed).max())
        at_rest = float(np.mean(np.abs(speed) <= _AT_REST * fastest))
        is_measured = data.qvel_std is None or not np.isinf(data.qvel_std[number])
        rows.append(
            [
                escape(name),
                f"{np.ptp(data.qpos[:, number]):.3g} {unit}",
                f"{np.sqrt(np.mean(speed**2)):.3g} {unit}/s",
                _reversals(speed, data.episode),
                f"{at_rest:.0%}",
                "yes" if is_measured else "no",
                slopes.get(name, "not compared"),
            ]
        )
    heads = ["joint", "range", "speed, RMS", "reversals", "at rest", "velocity measured"]
    return "<h2>Motion</h2>" + table([*heads, "force, per drive's"], rows) + _FORCES


def _reversals(speed: Vector, episode: Indices) -> int:
    """Changes of a speed's sign within episodes, also across rows in which it is zero."""
    moving = np.flatnonzero(speed)
    turned = np.diff(np.sign(speed[moving])) != 0
    return int(np.sum(turned & (np.diff(episode[moving]) == 0)))


def _shown(shown: Sequence[Excitation]) -> str:
    explained = (
        "<p>Nothing is fitted yet. Each effect, of a size that a sensible simulator might lack, is "
        f"compared with the scatter of the readings. It needs {THRESHOLD:g} nats to be named. This "
        "is the best case: free parameters, other effects, and errors that nothing explains hide "
        "some of it.</p>"
    )
    strong = [each for each in shown if each.is_shown]
    weak = [each for each in shown if not each.is_shown]
    heads = ["effect", "a sensible size", "nats at it", "smallest that could be seen"]
    lists = _listed(heads, strong) if strong else "<p><b>Nothing.</b></p>"
    if not weak:
        return explained + lists
    return (
        f"{explained}{lists}<details{' open' * (not strong)}><summary>{len(weak)} effects that "
        "these data cannot show at a sensible size: move these joints further, faster, back and "
        f"forth, or record longer</summary>{_listed(heads, weak)}</details>"
    )


def _listed(heads: Sequence[str], shown: Sequence[Excitation]) -> str:
    rows = [
        [
            escape(f"{each.kind} {each.location}"),
            _strength(each, each.sensible),
            f"{each.nats:.0f}" if each.nats >= 1 else "less than 1",
            _visible(each),
        ]
        for each in shown
    ]
    return table(heads, rows)


def _visible(each: Excitation) -> str:
    if not each.nats * _NEVER**2 >= THRESHOLD:
        return "none"
    return _strength(each, each.visible)


def _strength(each: Excitation, value: float) -> str:
    unit = "" if each.unit == "1" else f" {escape(each.unit)}"
    return f"{each.strength} {value:.2g}{unit}"


def _limits(converted: Converted) -> str:
    lines = [
        f"<li>{escape(name)}: {share:.1%} of all rows are at the model's limit or beyond.</li>"
        for name, share in converted.at_limit.items()
        if share >= _NOTICED
    ]

    return f"<ul>{''.join(lines)}</ul>" if lines else ""


def _read(record: Record) -> str:
    heads = ["quantity", "column", "readings", "ms apart", "range", "resampled by", "scatter"]
    rows = [_row(column) for column in record.columns]
    gaps = ", ".join(f"{a:.4g} to {b:.4g} s" for a, b in record.gaps[:_MOST_GAPS])
    more = f", and {len(record.gaps) - _MOST_GAPS} more" * (len(record.gaps) > _MOST_GAPS)
    lines = [f"<h3>{escape(record.source)}</h3>", table(heads, rows)]
    lines.append(_SCATTER)
    if gaps:
        lines.append(f"<p>Gaps, in which nothing was measured: {gaps}{more}.</p>")
    if crowded := max(column.crowded for column in record.columns):
        lines.append(
            f"<p>{crowded} readings of a column were left out, because they came too soon after "
            "the one before (half the usual time, or none). Of commands that came at one time, the "
            "last holds.</p>"
        )
    if timeless := max(column.timeless for column in record.columns):
        lines.append(f"<p>{timeless} readings of a column were left out: no time was logged.</p>")
    return "".join(lines)


def _row(column: Column) -> list[Any]:
    smallest, median, largest = (1000 * spacing for spacing in column.spacing)
    low, high = column.reach
    return [
        escape(column.quantity),
        escape(column.name),
        column.readings,
        "" if np.isnan(median) else f"{median:.4g} ({smallest:.4g} to {largest:.4g})",
        f"{low:.4g} to {high:.4g}",
        _RESAMPLING[column.way],
        "" if np.isnan(column.scatter) else f"{column.scatter:.2g}",
    ]


def _traces(converted: Converted, model: mujoco.MjModel) -> Figure:
    """All rows of all episodes, one after the other."""
    data, joints, drives = converted.measurement, joints_of(model), commanded_actuators(model)
    panels: list[tuple[str, Vector, str]] = []
    for number, name in enumerate(joints):
        unit = "m" if is_slide(model, name) else "rad"
        panels.append((f"{name} [{unit}]", data.qpos[:, number], _POSITION))
        blind = data.qvel_std is not None and np.isinf(data.qvel_std[number])
        inferred = "\nnot measured" if blind else ""
        colour = _INFERRED if blind else _VELOCITY
        panels.append((f"{name} [{unit}/s]{inferred}", data.qvel[:, number], colour))
    panels += [(name, data.ctrl[:, number], _COMMAND) for number, name in enumerate(drives)]
    figure = Figure(figsize=(8, 0.6 + 0.9 * len(panels)), layout="constrained")
    time = converted.period * np.arange(len(data.time), dtype=np.float64)
    starts = [converted.period * first for first, _ in data.spans()]
    axes = figure.subplots(len(panels), 1, sharex=True, squeeze=False)[:, 0]
    for ax, (label, values, colour) in zip(axes, panels, strict=True):
        _trace(ax, label, values, time, starts, colour)
    axes[-1].set_xlabel("seconds of the measurement (grey: where an episode begins)")
    return figure


def _trace(
    ax: Axes, label: str, values: Vector, time: Vector, starts: Sequence[float], colour: str
) -> None:
    for start in starts:
        ax.axvline(start, color="#cccccc", linewidth=0.5)
    every = max(len(time) // _MOST_POINTS, 1)
    ax.plot(time[::every], values[::every], ".", color=colour, markersize=1.5)
    ax.set_ylabel(label, rotation=0, ha="right", va="center", fontsize=8)
    ax.tick_params(labelsize=8)
