"""Figures of a small benchmark of all methods."""

import csv
import io
from dataclasses import replace

import pytest

from adr_service.benchmark.figures import FIGURES, draw, drawable
from adr_service.errors import InvalidInput, UnknownName
from adr_service.tasks.catalogue import source_of


@pytest.mark.parametrize("name", FIGURES)
def test_figures_repeat_byte_for_byte(benchmark, name):
    outcomes = [each for each in benchmark[2] if each.spec.variant == "vanilla"]
    svg = draw(name, outcomes, "svg")
    assert svg == draw(name, outcomes, "svg")
    assert b"</svg>" in svg
    assert draw(name, outcomes, "png").startswith(b"\x89PNG")


def test_the_papers_four_figures_and_four_more_can_be_drawn(benchmark):
    names = [f"returns-{variant}" for variant in ("vanilla", "noisy")]
    assert drawable(benchmark[2]) == [
        *names,
        "profile",
        "collection",
        "parameters",
        "spread",
        "cost",
    ]
    alone = [o for o in benchmark[2] if o.spec.variant == "noisy"]
    assert draw("returns-noisy", benchmark[2], "png") == draw("returns", alone, "png")
    with pytest.raises(UnknownName, match="vanilla, noisy"):
        draw("returns-windy", benchmark[2], "png")


def test_the_csv_of_a_figure_has_the_numbers_it_draws(benchmark):
    read = csv.DictReader(io.StringIO(draw("spread-vanilla", benchmark[2], "csv").decode()))
    drawn = list(read)
    assert {row["method"] for row in drawn} == {"simopt", "simopt_1", "droid", "dropo"}
    assert {row["normalised_std"] for row in drawn if row["iteration"] == "0"} == {"1.0"}
    assert {row["parameter"] for row in drawn} == set(source_of("arm", "vanilla").space.names)


def test_the_collection_has_all_collectors_of_the_methods_that_were_studied(benchmark):
    drawn = list(csv.DictReader(io.StringIO(draw("collection", benchmark[2], "csv").decode())))
    assert {row["method"] for row in drawn} == {"droid", "dropo", "sysid"}
    assert {row["collector"] for row in drawn} == {"simopt", "prior", "random"}


def test_a_variant_in_which_others_collected_has_no_figure_of_the_protocol(benchmark):
    """A running benchmark may have these first."""
    both = [o for o in benchmark[2] if o.spec.variant == "vanilla" or o.spec.collector != "simopt"]
    assert len({o.spec.variant for o in both}) == 2
    names = drawable(both)
    assert [name for name in names if name.startswith("returns")] == ["returns"]
    for name in ("returns", "profile", "spread"):
        assert draw(name, both, "svg")


def test_outcomes_without_distributions_have_no_figures_of_these(benchmark):
    changed = [replace(o, lost="of old 0.1") for o in benchmark[2]]
    assert set(drawable(benchmark[2])) - set(drawable(changed)) == {"parameters", "spread"}
    vanilla = [each for each in changed if each.spec.variant == "vanilla"]
    for name in drawable(vanilla):
        assert draw(name, vanilla, "svg")


def test_a_figure_of_nothing_or_of_no_such_name_is_refused(benchmark):
    with pytest.raises(InvalidInput, match="nothing to draw"):
        draw("returns", [], "svg")
    with pytest.raises(UnknownName, match="returns, profile, collection"):
        draw("return", benchmark[2], "svg")


def test_a_profile_waits_until_all_methods_have_a_task_in_common(benchmark):
    apart = [
        o
        for o in benchmark[2]
        if (o.spec.method.name, o.spec.variant) in {("udr", "vanilla"), ("prior", "noisy")}
    ]
    assert "profile" not in drawable(apart)
    with pytest.raises(InvalidInput, match="by all methods"):
        draw("profile", apart, "svg")
