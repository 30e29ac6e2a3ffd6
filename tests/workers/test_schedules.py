"""The dispatcher in thousands of simulated schedules of faults."""

import time

import pytest

from tests.workers.schedules.faults import CHANCES
from tests.workers.schedules.playing import play_all, silent


@pytest.mark.timeout(3600)
@pytest.mark.parametrize("count", [400, pytest.param(100_000, marks=pytest.mark.slow)])
def test_nothing_is_lost_or_done_twice_whatever_fails(count, record_property):
    """A failure names its seed; `python -m tests.workers.schedules SEED` plays that one again."""
    began = time.process_time()
    with silent():
        figures = play_all(range(count))
    record_property("figures", f"{figures}; CPU seconds {time.process_time() - began:.0f}")
    assert figures.schedules == count
    assert figures.faults.keys() == CHANCES.keys()


def test_a_schedule_is_the_same_when_it_is_played_again():
    with silent():
        first, again = (play_all(range(100, 103)) for _ in range(2))
    assert first == again
