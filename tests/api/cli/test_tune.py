"""Refusals of `adr tune` before anything starts."""

import pytest


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("arm", "--rates", "fast"), "learning rates must be numbers"),
        (("arm", "--rates", "0"), "learning rates must be positive; given [0.0]"),
        (("amr", "--rates", "0.1"), "task: there is no task 'amr'"),
    ],
)
def test_rates_that_cannot_be_tried_are_refused(adr_here, arguments, message):
    code, _, errors = adr_here("tune", *arguments)
    assert code == 2
    assert message in errors.replace("\n", " ")
