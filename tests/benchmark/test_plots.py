"""Plots of hand-made rows: panels, labels, lines and bands."""

import dataclasses

import numpy as np
import pytest
from matplotlib.collections import LineCollection

from adr_service.benchmark.aggregate import ProfilePoint
from adr_service.benchmark.comparison import InferenceCost, ParameterEstimate, Row
from adr_service.benchmark.plots import (
    plot_collection,
    plot_cost,
    plot_parameters,
    plot_profile,
    plot_returns,
    plot_spread,
)
from adr_service.methods.catalogue import methods


def row(**changes):
    fields = {field.name: 0.0 for field in dataclasses.fields(Row)}
    given = {"task": "arm", "variant": "vanilla", "method": "simopt", "collector": "simopt"}
    given |= {"iteration": 1, "normalised_return": 0.8, "low": 0.7, "high": 0.9, "seeds": 3}
    return Row(**{**fields, **given, **changes})


def estimate(**changes):
    given = {"task": "arm", "variant": "vanilla", "method": "dropo", "collector": "simopt"}
    given |= {"seed": 0, "iteration": 1, "parameter": "mass", "unit": "kg"}
    given |= {"mean": 1.1, "std": 0.2, "normalised_std": 0.3, "truth": 1.0}
    return ParameterEstimate(**{**given, **changes})


def cost(**changes):
    given = {"task": "arm", "variant": "vanilla", "method": "dropo", "collector": "simopt"}
    given |= {"iteration": 1, "seeds": 2, "inference_steps": 500.0, "inference_seconds": 2.0}
    return InferenceCost(**{**given, **changes})


def titles(figure):
    return [axis.get_title() for axis in figure.axes]


def line_of(axis, label):
    (line,) = [line for line in axis.lines if line.get_label() == label]
    return line


def test_returns_have_a_panel_per_task_and_variant_and_a_line_per_method():
    rows = [
        row(task=task, variant=variant, method=method, iteration=i, normalised_return=0.3 + 0.1 * i)
        for task in ("arm", "hopper")
        for variant in ("vanilla", "noisy")
        for method in ("simopt", "dropo")
        for i in (0, 1, 2)
    ]
    figure = plot_returns(rows)
    assert titles(figure) == ["arm, vanilla", "hopper, vanilla", "arm, noisy", "hopper, noisy"]
    line = line_of(figure.axes[0], "DROPO")
    assert np.round(line.get_xdata()).tolist() == [0, 1, 2]
    assert line.get_ydata() == pytest.approx([0.3, 0.4, 0.5])
    beside = line_of(figure.axes[0], "SimOpt").get_xdata() - line.get_xdata()
    assert np.abs(beside) == pytest.approx([0.06] * 3)


def test_a_reference_without_iterations_is_a_level_over_all_of_them():
    rows = [row(iteration=i) for i in range(3)]
    axis = plot_returns([*rows, row(method="oracle", normalised_return=1.2)]).axes[0]
    line = line_of(axis, "oracle")
    assert (line.get_xdata().tolist(), line.get_ydata().tolist()) == ([0, 2], [1.2, 1.2])


@pytest.mark.parametrize("method", ["udr", "prior"])
def test_levels_alone_are_drawn_without_any_bar(method):
    axis = plot_returns([row(method=method, iteration=0)]).axes[0]
    (level,) = [line for line in axis.lines if set(line.get_ydata()) != {1.0}]  # the threshold's
    assert set(level.get_ydata()) == {row().normalised_return}
    assert not [bars for bars in axis.collections if isinstance(bars, LineCollection)]


def test_bars_and_bands_are_intervals_and_the_note_names_the_numbers_of_seeds():
    rows = [row(iteration=0), row(iteration=1, seeds=5), row(iteration=2, low=None, high=None)]
    figure = plot_returns([*rows, row(method="oracle", low=0.75)])
    band, bars = figure.axes[0].collections
    ends = [segment[:, 1].tolist() for segment in bars.get_segments() if len(segment)]
    assert ends[:2] == [pytest.approx([0.7, 0.9])] * 2
    heights = band.get_paths()[0].vertices[:, 1]
    assert (heights.min(), heights.max()) == (0.75, 0.9)
    assert "seeds (here 3–5)" in figure.get_supxlabel()


def test_the_note_says_where_too_few_seeds_have_no_intervals():
    figure = plot_returns([row(seeds=2, low=None, high=None)])
    assert figure.get_supxlabel() == "no intervals: too few seeds (here 2)"


def test_the_note_says_what_a_method_has_seen_before_its_first_iteration():
    seen = [row(method="bayrn", iteration=0, target_transitions=n) for n in (3800.0, 3400.0)]
    for shown, told in ((seen[:1], "3,800"), (seen, "3,400 to 3,800")):
        figure = plot_returns([row(target_transitions=200.0), *shown])
        assert figure.get_supxlabel().endswith(f"; BayRn begins at {told} transitions")


def test_the_axis_of_a_hundred_iterations_has_few_whole_numbers():
    (axis,) = plot_returns([row(iteration=i) for i in range(101)]).axes
    ticks = axis.get_xticks()
    assert len(ticks) < 15
    assert all(tick == int(tick) for tick in ticks)


def test_of_many_methods_the_intervals_stand_beside_the_lines_and_at_the_end_alone():
    names = list(methods())
    figure = plot_returns([row(method=name, iteration=i) for name in names for i in (1, 2)])
    lines, last = figure.axes
    assert titles(figure) == ["arm, vanilla", "arm, vanilla, after the last iteration"]
    assert not lines.collections
    (line,) = [collection.get_segments() for collection in last.collections[:1]]
    assert line[0].tolist() == [[0, 0.7], [0, 0.9]]
    assert len(last.collections) == len(last.get_xticklabels()) == len(names)
    assert last.get_xticklabels()[names.index("dropo")].get_text() == "DROPO"


def test_a_method_that_has_fewer_iterations_says_after_which_it_is_shown():
    behind = {"dropo": 2, "udr": 0}
    rows = [row(method=name, iteration=behind.get(name, 5)) for name in methods()]
    _, last = plot_returns(rows).axes
    shown = dict(zip(methods(), (t.get_text() for t in last.get_xticklabels()), strict=True))
    assert (shown["dropo"], shown["udr"]) == ("DROPO (after 2)", "UDR")
    assert shown["simopt"] == "SimOpt"


@pytest.mark.parametrize(
    ("seeds", "label"),
    [
        ([3, 3, 3, 3, 3, 1], "DROPO (after 4)"),  # one seed that is ahead is no mean of several
        ([5, 5, 5, 5, 5, 3], "DROPO"),  # two that failed hold the others back no more
        ([3, 2, 1], "DROPO (after 1)"),  # at 0 it has learned nothing
    ],
)
def test_a_method_is_shown_after_the_last_iteration_of_enough_seeds(seeds, label):
    rows = [row(method=name, iteration=5) for name in methods() if name != "dropo"]
    rows += [
        row(method="dropo", iteration=i, normalised_return=0.1 * i, seeds=n)
        for i, n in enumerate(seeds)
    ]
    _, last = plot_returns(rows).axes
    names = [t.get_text() for t in last.get_xticklabels()]
    assert label in names
    (point,) = [line for line in last.lines if list(line.get_xdata()) == [names.index(label)]]
    after = 5 if label == "DROPO" else int(label[-2])
    assert point.get_ydata() == pytest.approx([0.1 * after])


@pytest.mark.parametrize(("count", "bands"), [(6, 6), (7, 0)])
def test_a_profile_has_bands_of_a_few_methods(count, bands):
    chosen = list(methods())[:count]
    points = [ProfilePoint(n, x, 1.0 - x, 0.9 - x, 1.0) for n in chosen for x in (0.0, 0.5)]
    figure = plot_profile(points)
    assert len(figure.axes[0].collections) == bands
    assert ("no bands" in figure.get_supxlabel()) == (bands == 0)
    assert all(
        line.get_ydata() == pytest.approx([1.0, 0.5]) for line in figure.axes[0].lines[:count]
    )


def test_the_collection_has_a_line_per_collector():
    rows = [
        row(method="droid", collector=c, iteration=i)
        for c in ("simopt", "random", "random_matched")
        for i in (1, 2)
    ]
    (axis,) = plot_collection(rows).axes
    assert axis.get_title() == "DROID on arm, vanilla"
    labels = {line.get_label() for line in axis.lines}
    assert {"SimOpt's trajectories", "random actions"} <= labels


def test_a_legend_has_what_any_panel_shows():
    """BayRn is in the first panel alone, and the last one of the first row is empty."""
    rows = [
        row(task="hopper", variant="noisy", method="bayrn"),
        row(task="arm", variant="noisy", method="dropo"),
        row(task="hopper", variant="vanilla", method="simopt"),
    ]
    figure = plot_returns(rows)
    (legend,) = [axis.get_legend() for axis in figure.axes if axis.get_legend() is not None]
    assert {text.get_text() for text in legend.get_texts()} == {
        "BayRn (full episodes)",
        "DROPO",
        "SimOpt",
    }
    second = plot_parameters([estimate(), estimate(parameter="friction", method="droid")])
    assert {t.get_text() for t in second.legends[0].get_texts()} == {"truth", "DROPO", "DROID"}


def test_many_methods_stand_at_their_own_iteration():
    chosen = [name for name, each in methods().items() if not each.is_reference]
    (axis,) = plot_parameters([estimate(method=name) for name in chosen]).axes
    assert len(chosen) > 10
    assert max(container.lines[0].get_xdata()[0] for container in axis.containers) < 1.6


def test_parameters_have_a_panel_each_with_their_truth_where_it_is_known():
    figure = plot_parameters(
        [estimate(), estimate(seed=1, mean=1.3), estimate(parameter="friction", truth=None)]
    )
    assert titles(figure) == ["mass [kg], arm vanilla", "friction [kg], arm vanilla"]
    mass, friction = figure.axes
    assert line_of(mass, "truth").get_ydata() == [1.0, 1.0]
    assert not [line for line in friction.lines if line.get_label() == "truth"]
    assert mass.containers[0].lines[0].get_ydata().tolist() == [1.1, 1.3]


def test_the_points_of_two_methods_stand_beside_each_other():
    (axis,) = plot_parameters([estimate(), estimate(method="droid")]).axes
    first, second = (container.lines[0].get_xdata()[0] for container in axis.containers)
    assert first == 1
    assert second == pytest.approx(1.12)


def test_the_spread_is_the_mean_over_seeds_on_a_logarithmic_axis():
    estimates = [estimate(seed=s, normalised_std=0.2 + 0.2 * s) for s in (0, 1)]
    (axis,) = plot_spread(estimates).axes
    assert line_of(axis, "mass").get_ydata() == pytest.approx([0.3])
    assert axis.get_yscale() == "log"
    assert axis.get_legend() is not None


def test_many_parameters_have_no_legend():
    estimates = [estimate(parameter=f"p{i}") for i in range(9)]
    (axis,) = plot_spread(estimates).axes
    assert axis.get_legend() is None


def test_costs_leave_out_methods_that_simulate_nothing_and_unknown_seconds():
    rows = [cost(), cost(method="bayrn", inference_steps=0.0, inference_seconds=None)]
    steps, seconds = plot_cost(rows).axes
    assert [line.get_label() for line in steps.lines] == ["DROPO"]
    assert [line.get_label() for line in seconds.lines] == ["DROPO"]
    assert np.array(steps.lines[0].get_ydata()).tolist() == [500.0]
    assert steps.get_ylabel() == "simulated control steps"
