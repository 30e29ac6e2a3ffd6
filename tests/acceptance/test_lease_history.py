"""The checker of lease histories finds what no service with exclusive leases can answer."""

import pytest

from adr_service.client import Refused, Unreachable
from tests.acceptance.lease_history import Asked, RecordedClient, read_history, violations

LEASE_S = 2.0


def asked(kind, lease, began, status=200, attempt=0):
    answered = {} if status is None else {"answered": began + 0.1, "status": status}
    return Asked(kind, "task_1", lease, began, attempt=attempt, **answered)


def first(*more, until=0.0):
    """A claim that is renewed until some second, and more requests."""
    beats = [asked("heartbeat", "a", second) for second in range(1, int(until) + 1)]
    return [asked("claim", "a", 0.0, attempt=1), *beats, *more]


def second(began, attempt=2, lease="b"):
    return asked("claim", lease, began, attempt=attempt)


@pytest.mark.parametrize(
    "history",
    [
        first(asked("trajectory", "a", 3.0), until=2),
        first(asked("trajectory", "a", 3.0), asked("trajectory", "a", 4.0)),
        first(second(3.1), asked("heartbeat", "a", 4.0, status=409), until=1),
        first(asked("release", "a", 1.0), second(1.2)),
        first(asked("release", "a", 1.0, status=None), second(1.2)),  # it may have been heard
        first(asked("heartbeat", "a", 1.0, status=None), second(2.5)),  # or not
        first(second(2.0), asked("heartbeat", "a", 2.05, status=None)),
        first(asked("trajectory", "a", 1.0, status=503), second(2.5)),
        [asked("claim", "", 0.0, status=204), asked("claim", "", 1.0, status=None)],
    ],
)
def test_what_a_right_service_answers_is_no_violation(history):
    assert violations(history, LEASE_S) == []


@pytest.mark.parametrize(
    ("history", "message"),
    [
        (first(second(3.0, lease="a")), "lease a was given 2 times"),
        (first(second(2.5, attempt=1)), "two claims have one number"),
        ([asked("claim", "a", 9.0, attempt=1), second(1.0)], "not in order"),
        (first(asked("trajectory", "a", 1.0), second(3.0)), "trajectory of the earlier"),
        (first(second(3.0), asked("trajectory", "a", 4.0)), "trajectory of the earlier"),
        (first(second(3.0), asked("heartbeat", "a", 4.0)), "a heartbeat of the earlier one was"),
        (first(second(3.0), until=2), "they overlap by 0.9 s"),
        (first(second(2.0), asked("heartbeat", "a", 2.05)), "they overlap by 1.95 s"),
        (first(second(1.0)), "they overlap by 0.9 s"),
    ],
)
def test_each_wrong_answer_is_named(history, message):
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
