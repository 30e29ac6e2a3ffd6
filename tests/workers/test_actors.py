"""A process that computes stages: each ending is a value, and signs of life go to the board."""

import json
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np
import pytest
import ray

from adr_service.progress import Checkpoint
from adr_service.stages.base import Cost, Result, Stage, compute
from tests.db.rows import UNMEASURED
from tests.planted import waving_policy
from tests.service import until
from tests.stages.examples import evaluation
from tests.workers.marks import RAY
from workers.actors import Failed, Finished, StageActor, Stopped
from workers.heartbeats import Board

pytestmark = RAY
PLACED = replace(UNMEASURED, attempt=3, cores=2)


class Nothing(Result):
    pass


@dataclass(frozen=True, kw_only=True)
class Wait(Stage[Nothing]):
    """Report progress until it is stopped, divide by zero, or end the process."""

    kind: ClassVar = "wait"
    version: ClassVar = 1
    role: ClassVar = "inference"
    result: ClassVar = Nothing

    divides: bool
    exits: bool = False

    def compute(self, rng, progress):
        progress(0.5, checkpoint=Checkpoint(10, b"weights", ()), steps=10)
        if self.exits:
            sys.exit(2)
        while not self.divides:
            time.sleep(0.01)
            progress(0.75)
        return 1 / 0

    def events(self, result):
        return []

    def cost(self, machine):
        return Cost(0.0)

    def stand_in(self):
        return Nothing()


@dataclass(frozen=True, kw_only=True)
class Tell(Wait):
    """Report what a user's method may, until it is stopped."""

    kind: ClassVar = "tell"
    divides: bool = False

    def compute(self, rng, progress):
        loss, guess = np.float32(0.5), np.array([1.0, 2.0])
        while True:
            progress(0.25, loss=loss, guess=guess, worst=np.nan, tried=np.int64(3), at="x")
            time.sleep(0.01)


@pytest.fixture(scope="module")
def only_board(cluster):
    return ray.remote(Board).options(num_cpus=0).remote()


@pytest.fixture
def board(only_board):
    """A board without news, to which every stage is wanted."""
    ray.get(only_board.news.remote(set()))
    return only_board


@pytest.fixture
def actor():
    return StageActor()


def test_a_result_comes_with_its_measured_execution(actor, board):
    stage = evaluation(policy=waving_policy().to_bytes())
    before = time.time()
    ending = actor.compute(stage, PLACED, board)
    assert isinstance(ending, Finished)
    assert ending.result == compute(stage)
    execution = ending.execution
    assert before <= execution.began <= execution.ended <= time.time()
    assert 0 <= execution.preparing <= execution.cpu
    assert {"python", "cpu", "mujoco", "numpy"} <= set(execution.provenance)


def test_a_clock_that_is_set_back_meanwhile_shortens_no_stage(actor, board, monkeypatch):
    began, steady = time.time(), time.monotonic()
    monkeypatch.setattr(time, "time", lambda: began - (time.monotonic() - steady))  # backwards
    stage = evaluation(policy=waving_policy().to_bytes())
    execution = actor.compute(stage, PLACED, board).execution
    assert execution.ended > execution.began


def test_an_execution_keeps_the_dispatchers_part(actor, board):
    stage = evaluation(policy=waving_policy().to_bytes())
    first, second = (actor.compute(stage, PLACED, board).execution for _ in range(2))
    for name in ("attempt", "started_by", "asked", "placed", "cores"):
        assert getattr(first, name) == getattr(PLACED, name)
    assert not second.is_first


def test_an_error_of_ours_ends_as_its_code_and_its_message(actor, board):
    ending = actor.compute(evaluation(policy=b"weights"), PLACED, board)
    assert isinstance(ending, Failed)
    assert ending.code == "invalid_input"
    assert ending.message.startswith("not the bytes of a policy")


def test_a_defect_ends_as_a_failure_with_the_place(actor, board):
    ending = actor.compute(Wait(task="arm", divides=True), PLACED, board)
    assert isinstance(ending, Failed)
    assert ending.code == "internal"
    assert ending.message.startswith("ZeroDivisionError: division by zero\n")
    assert "return 1 / 0" in ending.message


def test_a_stage_that_would_end_its_process_ends_as_a_failure(actor, board):
    """Its process counted as lost three times, and the run failed for lack of memory."""
    ending = actor.compute(Wait(task="arm", divides=False, exits=True), PLACED, board)
    assert isinstance(ending, Failed)
    assert (ending.code, ending.message.split("\n")[0]) == ("internal", "SystemExit: 2")


def test_a_stage_that_no_run_wants_is_stopped(actor, board):
    stage = Wait(task="arm", divides=False)
    ray.get(board.news.remote({stage.digest}))
    assert actor.compute(stage, PLACED, board) == Stopped()


def test_signs_of_life_have_the_progress_and_the_last_checkpoint(actor, board):
    stage = Wait(task="arm", divides=False)
    signs, checkpoints = [], {}

    def is_all_there():
        some, more = ray.get(board.news.remote(set()))
        signs.extend(some)
        checkpoints.update(more)
        return checkpoints and signs and signs[-1].fraction > 0

    with ThreadPoolExecutor() as pool:
        ending = pool.submit(actor.compute, stage, PLACED, board)
        until(is_all_there)
        ray.get(board.news.remote({stage.digest}))
        assert ending.result() == Stopped()
    assert {(sign.digest, sign.attempt) for sign in signs} == {(stage.digest, PLACED.attempt)}
    assert signs[-1].fraction <= 0.75
    assert set(checkpoints) == {stage.digest}


def test_signs_of_life_say_in_json_what_a_method_tells(actor, board):
    stage = Tell(task="arm")

    with ThreadPoolExecutor() as pool:
        ending = pool.submit(actor.compute, stage, PLACED, board)
        told = until(lambda: [s.facts for s in ray.get(board.news.remote(set()))[0] if s.facts])
        ray.get(board.news.remote({stage.digest}))
        assert ending.result() == Stopped()
    shown = {"loss": 0.5, "guess": "[1. 2.]", "worst": "nan", "tried": 3, "at": "x"}
    assert [json.loads(json.dumps(facts, allow_nan=False)) for facts in told] == [shown]
