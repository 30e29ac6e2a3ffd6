"""Figures of a criticism, as SVG texts by name; the same criticism gives the same bytes."""

import mujoco
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from adr_service.arrays import Matrix, Vector
from adr_service.criticism.decision import THRESHOLD
from adr_service.criticism.fits import Fit
from adr_service.criticism.page import svg
from adr_service.criticism.pipeline import Criticism
from adr_service.effects.models import unit_of

_BEFORE, _AFTER = "#D55E00", "#0072B2"  # Okabe and Ito
_MOST_RANKED, _MOST_POINTS = 12, 1500
_FEATURES = ("position", "velocity", "direction", "command", "time", "contact")


def draw_all(criticism: Criticism) -> dict[str, str]:
    """SVG by name; those of causes only where there are any."""
    figures = {"where": _draw(_where, criticism, 1.0), "ranking": _draw(_ranking, criticism, 1.2)}
    if criticism.verdict.gain is not None:
        figures["residual"] = _draw(_residual, criticism, 1.0)
        figures["horizons"] = _draw(_horizons, criticism, 0.8)
        figures["trace"] = _draw(_trace, criticism, 0.8)
    return figures


def _draw(painter: object, criticism: Criticism, height: float) -> str:
    figure = Figure(figsize=(8, 4 * height), layout="constrained")
    assert callable(painter)
    painter(figure, criticism)
    return svg(figure)


def _where(figure: Figure, criticism: Criticism) -> None:
    """Share of each joint's misfit that goes with each quantity."""
    shares = np.array([_explained(criticism.baseline, d) for d in range(_width(criticism))])
    figure.set_figheight(1.4 + 0.4 * len(shares))
    axes, most = figure.subplots(), max(5.0, 100 * shares.max())
    image = axes.imshow(100 * shares, cmap="magma_r", vmin=0, vmax=most, aspect="auto")
    axes.set_xticks(range(len(_FEATURES)), _FEATURES)
    axes.set_yticks(range(len(shares)), _joints(criticism))
    figure.colorbar(image, label="% of the misfit")
    axes.set_title("What the simulator's error at each joint goes with")


def _ranking(figure: Figure, criticism: Criticism) -> None:
    """Evidence for each candidate of the first scan."""
    best = [c for c in criticism.candidates[:_MOST_RANKED] if c.gain > 0]
    axes = figure.subplots()
    names = [f"{c.kind}, {c.location}" for c in best]
    errors = [np.sqrt(len(c.gains)) * c.gains.std(ddof=1) for c in best]
    gains = [c.gain for c in best]
    axes.barh(range(len(best)), gains, xerr=errors, color=_AFTER, ecolor="#555555")
    refined = {f"{c.kind}, {c.location}": c.gain for c in criticism.verdict.causes}
    names += [name for name in refined if name not in names]
    if refined:
        rows = [names.index(name) for name in refined]
        label = "named, and refined"
        axes.plot([*refined.values()], rows, "D", color=_BEFORE, markersize=5, label=label)
    axes.set_yticks(range(len(names)), names)
    axes.invert_yaxis()
    chance = "what chance can reach"
    axes.axvline(THRESHOLD, color="black", linestyle="--", linewidth=0.8, label=chance)
    figure.legend(loc="outside lower center", ncols=2, frameon=False)
    axes.set_xlabel("evidence [nats, ± standard error]")
    figure.suptitle("Candidates, each added alone, and what is named of them", fontsize="large")


def _residual(figure: Figure, criticism: Criticism) -> None:
    """The most affected velocity's error against what it may depend on, and the cause's share."""
    before, after = criticism.baseline, criticism.final
    dof = _most_changed(before, after)
    both = after.linear.chain.mask[before.linear.chain.mask]
    error = _unexplained(before)[both, dof]
    share = error - _unexplained(after)[before.linear.chain.mask[after.linear.chain.mask], dof]
    axes = figure.subplots(1, 4, sharey=True)
    rng = np.random.default_rng(0)  # which points are drawn
    shown = rng.permutation(len(error))[:_MOST_POINTS]
    for ax, (name, known) in zip(axes, _against(before, dof).items(), strict=True):
        values = known[both]
        ax.plot(values[shown], error[shown], ".", color=_BEFORE, markersize=5, alpha=0.4)
        ax.plot(values[shown], share[shown], ".", color=_AFTER, markersize=2)
        ax.set_xlabel(name)
        ax.locator_params(axis="x", nbins=4)
    axes[0].set_ylabel(f"velocity error of one step [{_unit(before, dof, 'velocity')}]")
    figure.suptitle(
        f"{_joints(criticism)[dof]}: the error (orange) and what the cause explains of it (blue)"
    )


def _horizons(figure: Figure, criticism: Criticism) -> None:
    gain = criticism.verdict.gain
    assert gain is not None
    axes = figure.subplots()
    steps = list(gain.horizons)
    for label, colour, column in (("as it is", _BEFORE, 0), ("extended", _AFTER, 1)):
        axes.plot(steps, [gain.horizons[s][column] for s in steps], "o-", color=colour, label=label)
    axes.set(xscale="log", yscale="log", xlabel="control steps ahead")
    is_measured = criticism.baseline.simulator.data.is_measured().all()
    unit = "what is expected of one step" if is_measured else "one step, extended"
    axes.set_ylabel(f"error, 1: {unit}")
    axes.set_title("Prediction of episodes that nothing was fitted to")
    axes.legend(frameon=False)
    _plain(axes, steps)


def _trace(figure: Figure, criticism: Criticism) -> None:
    """The most affected joint of one episode: measured, and simulated without and with causes."""
    gain = criticism.verdict.gain
    assert gain is not None
    trace, dof = gain.trace, _most_changed(criticism.baseline, criticism.final)
    nv = criticism.baseline.simulator.base.nv
    axes = figure.subplots(1, 2)
    measured = criticism.baseline.simulator.data.is_measured()
    for ax, column, what in zip(axes, (dof, nv + dof), ("position", "velocity"), strict=True):
        shown, colour = ("measured", "black") if measured[column] else ("not measured", "#999999")
        points = trace.measured[:, column]
        ax.plot(trace.time, points, ".", color=colour, markersize=3, label=shown)
        ax.plot(trace.time, trace.without[:, column], color=_BEFORE, label="as it is")
        ax.plot(trace.time, trace.extended[:, column], color=_AFTER, label="extended")
        ax.set(xlabel="time [s]", ylabel=f"{what} [{_unit(criticism.baseline, dof, what)}]")
        if column == dof or not measured[column]:
            ax.legend(frameon=False)
    figure.suptitle(f"{_joints(criticism)[dof]}: simulated from the first state on, without a look")


def _plain(axes: Axes, steps: list[int]) -> None:
    axes.set_xticks(steps, [str(s) for s in steps])
    axes.minorticks_off()


def _width(criticism: Criticism) -> int:
    return criticism.baseline.simulator.base.nv


def _joints(criticism: Criticism) -> list[str]:
    model = criticism.baseline.simulator.base
    return [model.joint(int(model.dof_jntid[d])).name for d in range(model.nv)]


def _unexplained(fit: Fit) -> Matrix:
    """(N, nv) velocity residuals that the fitted columns leave."""
    return fit.left[fit.linear.chain.mask][:, fit.simulator.base.nv :]


def _against(fit: Fit, dof: int) -> dict[str, Vector]:
    """(N,) quantities that an error may depend on, at one joint."""
    simulator, mask = fit.simulator, fit.linear.chain.mask
    rows = simulator.starts[fit.layout.index[mask]]
    nv = simulator.base.nv
    drives = [
        i
        for i in range(simulator.data.ctrl.shape[1])
        if simulator.base.actuator_trntype[i] == mujoco.mjtTrn.mjTRN_JOINT
        and simulator.base.actuator_trnid[i, 0] == simulator.base.dof_jntid[dof]
    ]
    commands = simulator.data.ctrl[rows][:, drives].sum(axis=1)
    return {
        f"position [{_unit(fit, dof, 'position')}]": fit.states[rows, dof],
        f"velocity [{_unit(fit, dof, 'velocity')}]": fit.states[rows, nv + dof],
        "command": commands,
        "time [s]": simulator.data.time[rows],
    }


def _unit(fit: Fit, dof: int, what: str) -> str:
    model = fit.simulator.base
    joint = model.joint(int(model.dof_jntid[dof])).name
    return unit_of(model, f"sensor:{joint}.{what}", "of the sensor")


def _explained(fit: Fit, dof: int) -> Vector:
    """(features,) share of a joint's squared error that goes with each, by itself."""
    error = _unexplained(fit)[:, dof]
    position, velocity, command, _ = _against(fit, dof).values()
    contact = fit.linear.chain.stiff[fit.linear.chain.mask].astype(float)
    features = [
        position,
        velocity,
        np.sign(velocity),
        command,
        np.arange(len(error)),
        contact,
    ]
    shares = [np.corrcoef(f, error)[0, 1] ** 2 if f.std() > 0 else 0.0 for f in features]
    return np.array(shares)


def _most_changed(before: Fit, after: Fit) -> int:
    removed = (_unexplained(before) ** 2).sum(axis=0) - (_unexplained(after) ** 2).sum(axis=0)
    return int(np.argmax(removed / (_unexplained(before) ** 2).sum(axis=0)))
