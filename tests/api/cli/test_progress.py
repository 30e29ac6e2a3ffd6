"""Failures of runs on a terminal."""

from adr_service.client.progress import headline
from adr_service.errors import FailureCode
from api.cli.progress import failures
from tests.client.test_progress import a_run


def test_a_failed_run_has_its_reason_and_a_remedy():
    seen = {"runs": [a_run("a", "succeeded"), a_run("b", "failed", error="the motor is hot")]}
    assert headline(seen) == "1/2 runs done, 1 failed"
    remedy = FailureCode.TARGET_FAILED.remedy
    assert failures(seen) == [f"b failed: the motor is hot\n    {remedy}"]
