"""Parts of a verdict; `tests/contracts/test_verdict_json.py` has its JSON."""

import numpy as np
import pytest

from adr_service.criticism.verdict import Conclusion, Experiment, StrengthInterval, share_text, sure


def test_a_confidence_is_never_complete():
    assert sure(0.731) == "73.1 % sure"
    assert sure(1.0) == "more than 99.9 % sure"


def test_an_unbounded_interval_is_null_in_json():
    interval = StrengthInterval("offset", 1.0, -np.inf, np.inf, "rad")
    assert interval.to_json() == {"value": 1.0, "low": None, "high": None, "unit": "rad"}
    assert interval.interval == "not determined"
    assert StrengthInterval("offset", 1.0, 0.5, 1.5, "rad").interval == "0.5 to 1.5"
    narrow = StrengthInterval("offset", 1.5, 1.499997, 1.500004, "rad")
    assert narrow.interval == "1.499997 to 1.500004"
    assert StrengthInterval("offset", 1.5, 1.5, 1.5, "rad").interval == "1.5 to 1.5"


@pytest.mark.parametrize(
    ("separation", "recorded", "is_worth_it", "is_seen"),
    [(5.0, 1.0, True, True), (5.0, 6.0, False, True), (1.0, 0.5, False, False)],
)
def test_an_experiment_is_worth_it_if_it_separates_more_than_the_recording(
    separation, recorded, is_worth_it, is_seen
):
    experiment = Experiment("push", separation, recorded)
    assert (experiment.is_worth_it, experiment.is_seen) == (is_worth_it, is_seen)


def test_a_conclusion_is_its_word():
    assert [str(each) for each in Conclusion] == ["cause", "tie", "none", "unknown"]


@pytest.mark.parametrize(
    ("share", "low", "high", "text"),
    [
        (0.8, 0.6, 0.9, "80.0 % [60.0, 90.0]"),
        (0.99996, 0.99994, 0.99998, "100.00 % [99.99, 100.00]"),
        (1.0, 1.0, 1.0, "100 %"),
        (0.123456, 0.123456, 0.123456, "12.3456 %"),
    ],
)
def test_a_share_has_digits_that_tell_its_ends_apart(share, low, high, text):
    assert share_text(share, low, high) == text
