"""Probabilities of improvement as matrices."""

from adr_service.benchmark.improvements import improvement_matrices
from adr_service.benchmark.statistics import Interval


def pair(method, other, probability, low=None, high=None, variant="vanilla"):
    return {
        "task": "arm",
        "variant": variant,
        "method": method,
        "other": other,
        "probability": probability,
        "low": low,
        "high": high,
    }


def test_a_pair_is_seen_from_both_sides():
    (matrix,) = improvement_matrices([pair("simopt", "dropo", 0.75, 0.5, 1.0)])
    assert matrix.names == ["simopt", "dropo"]
    assert matrix.rows == [
        ("simopt", [None, Interval(0.75, 0.5, 1.0)]),
        ("dropo", [Interval(0.25, 0.0, 0.5), None]),
    ]


def test_each_variant_with_an_interval_has_a_matrix():
    known, unknown = pair("simopt", "dropo", 0.5, 0.2, 0.8), pair("simopt", "udr", 0.5)
    noisy, few = {**known, "variant": "noisy"}, {**unknown, "variant": "unmodeled"}
    found = improvement_matrices([known, unknown, noisy, few])
    assert [matrix.variant for matrix in found] == ["vanilla", "noisy"]
    assert found[0].rows[0][1][1:] == [Interval(0.5, 0.2, 0.8), Interval(0.5, None, None)]
