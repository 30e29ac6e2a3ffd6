"""The `Stages` of a run, over a dispatcher whose answers the test gives."""

import threading
from concurrent.futures import Future

import pytest

from adr_service.errors import RunCancelled, StageFailed
from adr_service.stages.base import StageResult
from tests.generators import collect
from tests.stages.examples import evaluation
from workers.cluster import ClusterUnavailable
from workers.ray_stages import RayStages

STAGES = [evaluation(seed) for seed in range(3)]


class Answers:
    """Takes requests as the dispatcher does, and keeps their futures."""

    is_alive = True

    def __init__(self):
        self.asked = []

    def submit(self, stage, run_id):
        future = Future()
        self.asked.append((stage, run_id, future))
        return future

    def answer(self, *seeds):
        for seed in seeds:
            self.asked[seed][2].set_result(result(seed))


def result(seed):
    return StageResult({"returns": [float(seed)], "diverged_episodes": 0})


@pytest.fixture
def dispatcher():
    return Answers()


def test_results_come_in_the_order_of_the_stages_and_events_as_stages_finish(dispatcher):
    program = RayStages("run_a", dispatcher, lambda: False).all(STAGES)
    timer = threading.Timer(0.05, lambda: dispatcher.answer(1))
    timer.start()
    first = next(program)
    assert first.digest == STAGES[1].digest
    dispatcher.answer(2, 0)
    events, results = collect(program)
    assert [event.digest for event in events] == [STAGES[0].digest, STAGES[2].digest]
    assert [each.returns for each in results] == [[0.0], [1.0], [2.0]]
    assert {run_id for _, run_id, _ in dispatcher.asked} == {"run_a"}
    timer.join()


def test_one_stage_has_one_result(dispatcher):
    program = RayStages("run_a", dispatcher, lambda: False).run(STAGES[0])
    timer = threading.Timer(0.05, lambda: dispatcher.answer(0))
    timer.start()
    _, value = collect(program)
    assert value.returns == [0.0]
    timer.join()


def test_a_failed_stage_ends_the_program(dispatcher):
    program = RayStages("run_a", dispatcher, lambda: False).run(STAGES[0])
    failure = StageFailed("infer", "worker_lost", "killed")
    threading.Timer(0.05, lambda: dispatcher.asked[0][2].set_exception(failure)).start()
    with pytest.raises(StageFailed, match="infer: killed"):
        collect(program)


def test_a_cancelled_run_and_a_dead_cluster_end_the_wait(dispatcher):
    with pytest.raises(RunCancelled):
        collect(RayStages("run_a", dispatcher, lambda: True).run(STAGES[0]))
    dispatcher.is_alive = False
    with pytest.raises(ClusterUnavailable, match="restart the service"):
        collect(RayStages("run_a", dispatcher, lambda: False).run(STAGES[0]))
