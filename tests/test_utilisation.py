"""Where core seconds went, on timings whose answer can be said by hand."""

import pytest

from adr_service.benchmark.utilisation import Timing, utilisation


def timing(asked, placed, began, ended, **changes):
    given = {"cpu": ended - began, "preparing": 0.0, "is_first": False, "cores": 2}
    return Timing(asked, placed, began, ended, **{**given, **changes})


def test_two_stages_that_compute_all_the_time_use_both_cores():
    found = utilisation([timing(0, 0, 0, 10), timing(0, 0, 0, 10)])
    assert (found.cores, found.seconds, found.computing) == (2, 10, 20)
    assert (found.useful, found.overhead) == (1, 0)


def test_a_lone_stage_is_not_looked_at():
    """Between 10 and 30 one core could not have been busy."""
    found = utilisation([timing(0, 0, 0, 30), timing(0, 0, 0, 10)])
    assert (found.seconds, found.computing) == (10, 20)
    assert utilisation([timing(0, 0, 0, 30)]) is None
    assert utilisation([]) is None


def test_a_core_that_is_free_while_a_stage_waits_is_orchestration():
    found = utilisation([timing(0, 0, 0, 10), timing(0, 4, 5, 10)])
    assert found.orchestration == pytest.approx(4 + 1)
    assert found.overhead == pytest.approx(5 / 20)
    assert found.useful == pytest.approx(15 / 20)


def test_a_process_that_starts_and_prepares_is_told_apart():
    late = timing(0, 0, 3, 10, is_first=True, preparing=2.0)
    found = utilisation([timing(0, 0, 0, 10), late])
    assert (found.starting, found.preparing, found.computing) == pytest.approx((3, 2, 15))
    assert (found.useful, found.overhead) == pytest.approx((1, 0))


def test_a_stage_without_a_cpu_waits():
    """Others had it: a quarter of the window's core seconds did no work."""
    found = utilisation([timing(0, 0, 0, 10), timing(0, 0, 0, 10, cpu=5.0)])
    assert found.waiting == pytest.approx(5)
    assert found.useful == pytest.approx(0.75)


def test_everything_adds_up():
    timings = [
        timing(0, 0.1, 1, 4, cpu=2.5, preparing=0.5, is_first=True),
        timing(0, 0.2, 0.3, 7, cpu=6),
        timing(2, 4.2, 4.3, 9, cpu=4),
        timing(3, 7.1, 7.2, 12, cpu=4.5),
    ]
    found = utilisation(timings)
    parts = (
        found.computing,
        found.starting,
        found.preparing,
        found.waiting,
        found.orchestration,
    )
    assert all(part >= 0 for part in parts)
    assert sum(parts) == pytest.approx(found.cores * found.seconds)
