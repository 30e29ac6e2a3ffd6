"""The checker of lease histories finds what no service with exclusive leases can answer."""

import pytest

from adr_service.client import Refused, Unreachable
from tests.acceptance.lease_history import RecordedClient, Request, read_history, violations

LEASE_S = 2.0


def request(kind, lease, began, status=200, attempt=0):
    answered = {} if status is None else {"answered": began + 0.1, "status": status}
    return Request(kind, "task_1", lease, began, attempt=attempt, **answered)


def first(*more, until=0.0):
    """A claim that is renewed until some second, and more requests."""
    beats = [request("heartbeat", "a", second) for second in range(1, int(until) + 1)]
    return [request("claim", "a", 0.0, attempt=1), *beats, *more]


def second(began, attempt=2, lease="b"):
    return request("claim", lease, began, attempt=attempt)


@pytest.mark.parametrize(
    "history",
    [
        first(request("trajectory", "a", 3.0), until=2),
        first(request("trajectory", "a", 3.0), request("trajectory", "a", 4.0)),
        first(second(3.1), request("heartbeat", "a", 4.0, status=409), until=1),
        first(request("release", "a", 1.0), second(1.2)),
        first(request("release", "a", 1.0, status=None), second(1.2)),  # it may have been heard
        first(request("heartbeat", "a", 1.0, status=None), second(2.5)),  # or not
        first(second(2.0), request("heartbeat", "a", 2.05, status=None)),
        first(request("trajectory", "a", 1.0, status=503), second(2.5)),
        [request("claim", "", 0.0, status=204), request("claim", "", 1.0, status=None)],
    ],
)
def test_histories_of_exclusive_leases_have_no_violations(history):
    assert violations(history, LEASE_S) == []


@pytest.mark.parametrize(
    ("history", "message"),
    [
        (first(second(3.0, lease="a")), "lease a was given 2 times"),
        (first(second(2.5, attempt=1)), "two claims have one number"),
        ([request("claim", "a", 9.0, attempt=1), second(1.0)], "not in order"),
        (first(request("trajectory", "a", 1.0), second(3.0)), "trajectory of the earlier"),
        (first(second(3.0), request("trajectory", "a", 4.0)), "trajectory of the earlier"),
        (first(second(3.0), request("heartbeat", "a", 4.0)), "a heartbeat of the earlier one was"),
        (first(second(3.0), until=2), "they overlap by 0.9 s"),
        (first(second(2.0), request("heartbeat", "a", 2.05)), "they overlap by 1.95 s"),
        (first(second(1.0)), "they overlap by 0.9 s"),
        (first(request("release", "a", 1.0, status=409), second(1.2)), "they overlap by 0.7 s"),
    ],
)
def test_each_contradiction_is_named(history, message):
    assert any(message in found for found in violations(history, LEASE_S))


@pytest.mark.ray
def test_requests_are_written_with_their_answers_and_without(tmp_path, service):
    log, unreachable = tmp_path / "log", pytest.raises(Unreachable)
    with log.open("a") as file, RecordedClient(service.client.url, 60.0, file) as client:
        assert client.claim_task("a", ["hopper"], wait_s=0) is None
        with pytest.raises(Refused):
            client.heartbeat("task_0", "nobody's", 3)
        client.list_all("target_tasks")
    nobody = "http://127.0.0.1:9"
    with log.open("a") as file, RecordedClient(nobody, 1.0, file) as client, unreachable:
        client.complete_task("task_1", "mine", b"")
    claim, heartbeat, trajectory = read_history([log])
    assert (claim.kind, claim.status, claim.lease, claim.is_unknown) == ("claim", 204, "", False)
    assert (heartbeat.visit, heartbeat.lease, heartbeat.status) == ("task_0", "nobody's", 404)
    assert (trajectory.kind, trajectory.lease) == ("trajectory", "mine")
    assert trajectory.is_unknown
    assert claim.began < claim.answered < heartbeat.began
