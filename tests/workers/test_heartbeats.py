"""The board of signs of life, in this process; and the patience with silent stages."""

from dataclasses import replace
from unittest.mock import MagicMock

import pytest

from adr_service.progress import Checkpoint
from workers.heartbeats import (
    FIRST_SIGN_S,
    SILENT_S,
    UNWANTED_SILENT_S,
    Board,
    Heartbeats,
    SignOfLife,
    patience_s,
)

SIGN = SignOfLife("digest", 1, 0.5, {"steps": 10}, "actor", 1)
CHECKPOINT = Checkpoint(10, b"weights", ())


@pytest.fixture
def board():
    return Board()


def test_news_are_the_latest_signs_since_the_last_call(board):
    for fraction in (0.1, 0.2):
        board.report(replace(SIGN, fraction=fraction))
    board.report(replace(SIGN, digest="another"))
    signs, _ = board.news(set())
    assert {sign.digest: sign.fraction for sign in signs} == {"digest": 0.2, "another": 0.5}
    assert board.news(set()) == ([], {})


def test_a_lost_process_that_still_reports_does_not_hide_the_next_attempt(board):
    attempts = [replace(SIGN, attempt=2), SIGN]
    for sign in attempts:
        board.report(sign)
    assert board.news(set())[0] == attempts


def test_a_checkpoint_outlives_later_signs_without_one(board):
    board.report(replace(SIGN, checkpoint=CHECKPOINT))
    board.report(SIGN)
    signs, checkpoints = board.news(set())
    assert (signs, checkpoints) == ([SIGN], {"digest": CHECKPOINT})


def test_a_report_is_answered_with_whether_to_stop(board):
    assert not board.report(SIGN)
    board.news({"digest"})
    assert board.report(SIGN)
    board.news(set())
    assert not board.report(SIGN)


def test_an_unwanted_stage_has_the_least_patience_and_a_starting_one_the_most():
    assert patience_s(None, 1) == FIRST_SIGN_S
    assert patience_s(SIGN, 1) == SILENT_S
    assert patience_s(None, 0) == patience_s(SIGN, 0) == UNWANTED_SILENT_S
    assert UNWANTED_SILENT_S < SILENT_S < FIRST_SIGN_S


def test_a_board_that_starts_may_be_silent_for_longer_than_one_that_has_answered(monkeypatch):
    ray, clock = MagicMock(), MagicMock()
    ray.get.return_value = ([], {})
    monkeypatch.setattr("workers.heartbeats.ray", ray)
    monkeypatch.setattr("workers.heartbeats.time.monotonic", clock)
    monkeypatch.setattr("workers.heartbeats.NodeAffinitySchedulingStrategy", MagicMock())
    clock.return_value = 0.0
    heartbeats = Heartbeats()

    def look(seconds, answers):
        """Ask the board and read its answer; true if it is replaced."""
        ray.kill.reset_mock()
        ray.wait.return_value = ([heartbeats], []) if answers else ([], [])
        for later in (1.0, seconds):
            clock.return_value += later
            heartbeats.news(set())
        return ray.kill.called

    assert look(FIRST_SIGN_S + 1, answers=False)
    assert not look(FIRST_SIGN_S - 1, answers=False)
    look(0.0, answers=True)
    assert look(UNWANTED_SILENT_S + 1, answers=False)
