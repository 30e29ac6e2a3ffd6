"""Requests that are sent again, by a clock that only requests and pauses move."""

import pytest

from adr_service.client import patience
from adr_service.client.http import Refused, Unreachable
from adr_service.client.patience import may_be_done, patiently

LOST = Unreachable("the answer was lost", may_be_done=True)


class Clock:
    def __init__(self):
        self.now = 0.0

    def monotonic(self):
        return self.now

    def sleep(self, seconds):
        self.now += seconds


@pytest.fixture
def clock(monkeypatch):
    clock = Clock()
    monkeypatch.setattr(patience, "time", clock)
    return clock


def asking(clock, seconds, *answers):
    """A request that takes so long each time, and gives or raises these answers in turn."""
    left = iter(answers)

    def ask():
        clock.now += seconds
        answer = next(left)
        if isinstance(answer, Exception):
            raise answer
        return answer

    return ask


def test_an_answer_that_was_lost_after_longer_than_the_patience_is_asked_for_again(clock):
    """A request may wait a minute for its answer, and a submission has half of one."""
    ask = asking(clock, 60.0, LOST, "stored")
    assert patiently(ask, 30.0, 1.0, begins=may_be_done) == "stored"
    assert clock.now == 121.0


def test_patience_ends_so_long_after_the_first_failure(clock):
    with pytest.raises(Unreachable):
        patiently(asking(clock, 4.0, *[LOST] * 9), 30.0, 1.0)
    assert clock.now == 34.0


def test_what_the_service_refuses_for_good_is_asked_once(clock):
    with pytest.raises(Refused):
        patiently(asking(clock, 1.0, Refused(422, "no")), 30.0, 1.0)
    with pytest.raises(Unreachable):  # nor is a request that cannot have come
        patiently(asking(clock, 1.0, Unreachable("nobody")), 30.0, 1.0, begins=may_be_done)
    assert clock.now == 2.0
