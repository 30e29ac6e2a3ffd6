"""Heartbeats of an episode, with a service whose answers the test gives."""

import threading
import time

import pytest

from adr_service.client.http import Refused, Unreachable
from adr_service.client.robot import heart
from adr_service.client.robot.heart import Heart, now

# a third of the lease lies between two heartbeats, which a busy machine may send half a second late
CLAIMED = {"task": {"id": "task_a"}, "lease": "lease_a", "lease_s": 1.5}


class Service:
    """A client that answers every heartbeat in the same way."""

    def __init__(self, answer):
        self.answer, self.beats, self.asked = answer, [], threading.Event()

    def heartbeat(self, *given):
        self.beats.append(given)
        if len(self.beats) == 3:
            self.asked.set()
        if isinstance(self.answer, Exception):
            raise self.answer
        return self.answer

    def __enter__(self):
        return self

    def __exit__(self, *_):
        pass


def heart_of(service, hangs=pytest.fail, *, asked=None, **changes):
    return Heart(service, {**CLAIMED, **changes}, now() if asked is None else asked, hangs)


def test_heartbeats_renew_the_lease_with_the_number_of_steps():
    service = Service({"cancel_requested": False})
    with heart_of(service) as beating:
        beating.watch.steps = 7
        assert service.asked.wait(20)
    assert service.beats[-1] == ("task_a", "lease_a", 7)


@pytest.mark.parametrize(
    ("answer", "why"),
    [
        ({"cancel_requested": True}, "its run was asked to stop"),
        (Refused(409, "the lease is lost"), "the lease is lost"),
        (Refused(401, "the token is not known"), "the token is not known"),
        (Refused(404, "there is no task"), "there is no task"),
        ({}, "the answer to a heartbeat cannot be read"),
    ],
)
def test_an_episode_stops_for_good_with_the_reason(answer, why):
    service = Service(answer)
    with heart_of(service, lease_s=60.0) as beating:
        stopped = threading.Event()
        while not beating.why_stop():
            stopped.wait(0.01)
    assert why in beating.why_stop()
    assert len(service.beats) == 1


@pytest.mark.parametrize(
    "answer",
    [
        Unreachable("no answer"),
        Refused(503, "not ready", 5.0),
        Refused(429, "too many", 1.0),
        Refused(500, "the service has a defect"),
    ],
)
def test_a_service_that_does_not_answer_stops_the_episode_when_the_lease_ends(answer):
    service = Service(answer)
    with heart_of(service) as beating:
        stopped = threading.Event()
        while not beating.why_stop():
            stopped.wait(0.01)
    assert "did not answer for as long as the lease lasts" in beating.why_stop()
    assert len(service.beats) > 1


def test_a_lease_is_counted_from_when_it_was_asked_for(monkeypatch):
    """The service may have renewed it at once, and answered much later."""
    clock = [1000.0]
    monkeypatch.setattr(heart, "now", lambda: clock[0])

    class Slow(Service):
        def heartbeat(self, *given):
            clock[0] += 54.0
            return super().heartbeat(*given)

    service = Slow({"cancel_requested": False})
    with heart_of(service, lease_s=60.0, asked=1000.0) as beating:
        assert beating.why_stop() == ""
        clock[0] = 1060.5
        assert "did not answer for as long as the lease lasts" in beating.why_stop()


def test_the_clock_of_a_lease_goes_on_while_the_computer_is_suspended():
    assert now.args == (time.CLOCK_BOOTTIME,)


def test_a_call_that_does_not_return_is_reported_once():
    reports, reported = [], threading.Event()

    def hangs(why):
        reports.append(why)
        reported.set()

    with (
        heart_of(Service({"cancel_requested": False}), hangs) as beating,
        beating.watch.watching("step", 0.01),
    ):
        assert reported.wait(20)
    assert reports == ["the environment's step did not return within 0.0 s"]
    assert beating.why_stop() == reports[0]


def test_a_first_heartbeat_decides_whether_anything_moves():
    """Also where the answer to the claim took longer than the lease."""
    service = Service({"cancel_requested": False})
    with heart_of(service, lease_s=60.0, asked=now() - 90) as beating:
        assert len(service.beats) == 1
        assert beating.why_stop() == ""
    with heart_of(Service(Unreachable("no answer")), lease_s=60.0, asked=now() - 90) as beating:
        assert "did not answer for as long as the lease lasts" in beating.why_stop()


class Stalled(Service):
    """Answers the first heartbeat, and no other."""

    def heartbeat(self, *given):
        answer = super().heartbeat(*given)
        if len(self.beats) > 1:
            self.asked.wait(20)
        return answer


def test_a_network_that_stalls_does_not_blind_the_watch():
    service, reported = Stalled({"cancel_requested": False}), threading.Event()
    with heart_of(service, lambda why: reported.set(), lease_s=0.3) as beating:
        while len(service.beats) < 2:
            reported.wait(0.01)
        with beating.watch.watching("step", 0.01):
            assert reported.wait(10)
        service.asked.set()


def test_the_first_reason_to_stop_stays_and_ends_the_heartbeats():
    service, reported = Service({"cancel_requested": False}), threading.Event()
    with heart_of(service, lambda why: reported.set(), lease_s=0.3) as beating:
        with beating.watch.watching("step", 0.01):
            assert reported.wait(20)
        beats = len(service.beats)
        service.answer = Refused(409, "the lease is lost")
        reported.clear()
        reported.wait(0.5)
    assert "did not return within" in beating.why_stop()
    assert len(service.beats) <= beats + 1  # one may have been on its way
