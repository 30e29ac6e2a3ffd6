"""Time for leases."""

from datetime import UTC, datetime, timedelta

from db.clock import SteadyClock

START = datetime(2026, 1, 1, tzinfo=UTC)


def test_the_clock_starts_at_the_wall_clocks_time_and_follows_the_steady_one_alone():
    wall, steady = [START], [1000.0]
    clock = SteadyClock(lambda: wall[0], lambda: steady[0])
    assert clock.now() == START
    wall[0] += timedelta(days=400)
    steady[0] += 1.5
    assert clock.now() == START + timedelta(seconds=1.5)


def test_the_time_is_in_utc():
    assert SteadyClock().now().utcoffset() == timedelta(0)
