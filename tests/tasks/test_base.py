"""Sources, hidden truths and variants."""

import numpy as np
import pytest

from adr_service.errors import UnknownName
from adr_service.parameters import Parameter, ParameterSpace
from adr_service.tasks.base import Hidden, Source, State, Variant, benchmark_variants, freeze

SPACE = ParameterSpace(
    tuple(Parameter(n, f"body:{n}.mass", "kg", 0.5, 10.0, 0.1) for n in ("a", "b", "c"))
)
TRUTH = (1.0, 2.0, 3.0)


def test_freezing_takes_parameters_out_and_fixes_them_at_four_fifths_of_the_truth():
    source = freeze(SPACE, TRUTH, ["b"])
    assert source.space.names == ("a", "c")
    assert source.fixed == {"body:b.mass": 0.8 * 2.0}


def test_freezing_nothing_changes_nothing():
    source = freeze(SPACE, TRUTH, [])
    assert (source.space, dict(source.fixed)) == (SPACE, {})


def test_freezing_an_unknown_parameter_is_refused():
    with pytest.raises(UnknownName, match="a, b, c"):
        freeze(SPACE, TRUTH, ["d"])


def test_the_three_variants_share_one_truth_and_differ_in_source_or_noise():
    variants = benchmark_variants(SPACE, TRUTH, 0.1, freeze(SPACE, TRUTH, ["b"]))
    variants = {name: variants[name] for name in ("vanilla", "noisy", "unmodeled")}
    for variant in variants.values():
        np.testing.assert_array_equal(variant.hidden.values, TRUTH)
        assert variant.hidden.source.space == SPACE
    assert [v.hidden.noise_variance for v in variants.values()] == [0.0, 0.1, 0.0]
    assert variants["noisy"].source == variants["vanilla"].source


def test_the_search_ends_at_the_truth_of_what_would_be_frozen_or_before_it():
    variants = benchmark_variants(SPACE, TRUTH, 0.1, freeze(SPACE, TRUTH, ["b"]))
    assert list(variants)[3:] == ["edge", "outside"]
    assert variants["edge"].source.space.high.tolist() == [10.0, 2.0, 10.0]
    assert variants["outside"].source.space.high.tolist() == [10.0, 1.6, 10.0]
    for name in ("edge", "outside"):
        assert variants[name].hidden is variants["vanilla"].hidden
        assert variants[name].source.space.low.tolist() == SPACE.low.tolist()


@pytest.mark.parametrize(
    ("truth", "frozen"),
    [
        (TRUTH, []),
        ((0.6, 2.0, 3.0), ["a"]),
        ((-1.0, 2.0, 3.0), ["a"]),
        ((11.0, 2.0, 3.0), ["a"]),
    ],
)
def test_there_are_three_variants_where_no_search_can_end_before_the_truth(truth, frozen):
    variants = benchmark_variants(SPACE, truth, 0.1, freeze(SPACE, truth, frozen))
    assert list(variants) == ["vanilla", "noisy", "unmodeled"]


def test_the_truth_of_a_variant_follows_its_sources_order():
    source = Source(ParameterSpace((SPACE.parameters[2], SPACE.parameters[0])))
    variant = Variant(source, Hidden(Source(SPACE), np.array(TRUTH), 0.0))
    assert variant.truth.tolist() == [3.0, 1.0]


def test_a_state_has_no_derived_values_unless_they_are_given():
    assert State(np.zeros((2, 3)), np.zeros((2, 3))).derived.size == 0
