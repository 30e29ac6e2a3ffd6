"""Stages on Ray: shared, cancelled, lost; the same bytes on one core or two."""

import os
import re
import signal
import threading
from contextlib import suppress
from dataclasses import replace
from pathlib import Path

import psutil
import pytest
from ray.exceptions import OutOfDiskError, RayError

from adr_service.errors import InvalidInput, RunCancelled, StageFailed
from adr_service.programs import run
from adr_service.specs import RunSpec
from adr_service.stages.base import compute
from adr_service.stages.local import LocalStages
from adr_service.training.policy import Policy
from tests.service import until
from tests.stages.examples import evaluation, policy, training
from tests.workers.marks import RAY
from tests.workers.stores import Store
from workers.cluster import RayOptions
from workers.dispatcher import Dispatcher
from workers.ray_stages import RayStages

pytestmark = RAY


def long_training(seed):
    return training(seed, max_steps=10_000_000, evaluate_every=10_000_000)


@pytest.fixture(scope="module")
def started(ray_folder):
    """A dispatcher on two cores, and its store."""
    store = Store()
    os.environ["RAY_USAGE_STATS_ENABLED"] = "0"
    options = RayOptions(
        cpus=2,
        dashboard=False,
        compile_cache=ray_folder / "jax",
        folder=ray_folder,
        keep_idle_s=30,
    )
    dispatcher = Dispatcher(options, store)
    dispatcher.start()
    yield dispatcher, store
    dispatcher.close()


def running(dispatcher, run_id):
    return [a for a in dispatcher.activities(run_id) if a.state == "running"]


def test_a_stage_gives_the_same_on_ray_as_here(started):
    dispatcher, _ = started
    stage = training(1)
    assert dispatcher.submit(stage, "run_a").result(60) == compute(stage)


def test_inputs_that_are_no_json_end_the_run_that_has_them_alone(started):
    """They stopped the dispatcher, and with it all runs, whenever the service started again."""
    dispatcher, _ = started
    stage = replace(training(97), start=object())
    with pytest.raises(InvalidInput, match="an input of train_policy is no JSON"):
        dispatcher.submit(stage, "run_a")
    stage = replace(training(97), seed=float("-inf"))
    with pytest.raises(InvalidInput, match="an input of train_policy is no JSON: Out of range"):
        dispatcher.submit(stage, "run_a")
    assert dispatcher.submit(training(97), "run_b").result(60) == compute(training(97))


class Unsendable(int):
    """An input that is JSON, and that Ray cannot take so many times."""

    def __new__(cls, error, times):
        number = super().__new__(cls, 98)
        number.error, number.times = error, times
        return number

    def __reduce__(self):
        self.times -= 1
        if self.times >= 0:
            raise self.error
        return int, (98,)


@pytest.mark.parametrize(
    ("error", "message", "cause"),
    [
        (TypeError("a lock"), r"cannot be pickled for another process: .*a lock", "internal"),
        (RayError("no such actor"), "3 times; last: no such actor", "worker_lost"),
    ],
)
def test_a_stage_that_ray_cannot_take_fails_alone(started, error, message, cause):
    """It stopped the dispatcher as well."""
    dispatcher, _ = started
    stage = replace(training(98), seed=Unsendable(error, 3))
    with pytest.raises(StageFailed, match=message) as failed:
        dispatcher.submit(stage, "run_a").result(60)
    assert failed.value.cause == cause
    assert dispatcher.submit(training(97), "run_b").result(60) == compute(training(97))


def test_a_stage_waits_while_the_disk_is_full(started):
    """After three seconds its process was said to be lost, three times."""
    dispatcher, _ = started
    stage = replace(training(98), seed=Unsendable(OutOfDiskError("the disk is full"), 4))
    assert dispatcher.submit(stage, "run_a").result(60) == compute(training(98))


def test_a_training_reports_its_checkpoint_while_it_goes_on(started):
    dispatcher, store = started
    stage = training(5, max_steps=10_000_000, evaluate_every=1000)
    result = dispatcher.submit(stage, "run_watched")
    noted = until(lambda: [n for n in store.notes if n[0] == stage.digest])
    finished = result.done()
    dispatcher.withdraw("run_watched")
    until(lambda: not running(dispatcher, "run_watched"))
    _, checkpoint, run_ids = noted[0]
    assert (finished, run_ids) == (False, ["run_watched"])
    assert checkpoint.events[0].steps == 1008  # of twelve environments
    assert Policy.from_bytes(checkpoint.content).action_low.tolist() == [-1, -1]


def test_equal_stages_are_computed_once_for_all_who_ask(started):
    dispatcher, store = started
    stage = training(2)
    futures = [dispatcher.submit(stage, f"run_{i}") for i in range(5)]
    assert len({future.result(60).blobs["policy"] for future in futures}) == 1
    commits = [c for c in store.commits if c[0] == stage.digest]
    assert commits == [(stage.digest, 1, "run_0", [f"run_{i}" for i in range(5)])]
    assert dispatcher.submit(stage, "run_later").result(5) == store.results[stage.digest]


def test_a_run_may_ask_for_the_same_stage_twice_at_once(started):
    dispatcher, _ = started
    first, second = (dispatcher.submit(training(3), "run_twice") for _ in range(2))
    assert first.result(60) == second.result(60)


@pytest.mark.slow
def test_a_process_serves_one_run_after_the_other_and_ends_when_idle(started):
    dispatcher, store = started
    policy = dispatcher.submit(training(9), "run_before").result(60).blobs["policy"]
    stage = training(10, max_steps=6_000)
    future = dispatcher.submit(stage, "run_after")
    seen = until(lambda: [a for a in running(dispatcher, "run_after") if a.pid])[0]
    future.result(60)
    assert re.fullmatch(r"adr:run_\w+:trainer:[0-9a-f]{6}-\d+", seen.actor)
    assert "run_after" not in seen.actor  # it bears the name of the run that it was started for
    evaluating = evaluation(policy=policy)
    dispatcher.submit(evaluating, "run_after").result(60)
    assert [store.executions[s.digest].is_first for s in (stage, evaluating)] == [False, False]
    until(lambda: not Path(f"/proc/{seen.pid}").exists())


def test_a_running_stage_shows_life(started):
    """Its progress grows within five seconds."""
    dispatcher, _ = started
    dispatcher.submit(long_training(20), "run_live")
    first = until(lambda: [a for a in running(dispatcher, "run_live") if a.facts])[0]
    later = until(
        lambda: [a for a in running(dispatcher, "run_live") if a.fraction > first.fraction], 5
    )[0]
    assert later.facts["steps"] > first.facts["steps"]
    dispatcher.withdraw("run_live")
    until(lambda: not dispatcher.activities("run_live"))


def test_a_stage_is_stopped_only_when_nobody_wants_it(started):
    dispatcher, store = started
    stage = training(30, max_steps=3_000, evaluate_every=3_000)
    dispatcher.submit(stage, "run_gone")
    wanted = dispatcher.submit(stage, "run_stays")
    until(lambda: running(dispatcher, "run_stays"))
    dispatcher.withdraw("run_gone")
    assert wanted.result(120).values["steps"] >= 3_000
    assert store.commits[-1][3] == ["run_stays"]


def test_a_withdrawn_stage_stops_and_frees_its_core(started):
    dispatcher, store = started
    for seed in (40, 41):
        dispatcher.submit(long_training(seed), "run_withdrawn")
    until(lambda: len(running(dispatcher, "run_withdrawn")) == 2)
    dispatcher.withdraw("run_withdrawn")
    assert dispatcher.submit(training(42), "run_next").result(60)
    assert long_training(40).digest not in store.results


def test_a_withdrawn_stage_that_never_asks_whether_to_stop_is_killed(started, monkeypatch):
    """It kept its core until it ended by itself."""
    dispatcher, _ = started
    weights = policy((4, 2000, 2000, 2)).to_bytes()
    stage = replace(evaluation(45, policy=weights), episodes=2000)  # of a minute, in one piece
    dispatcher.submit(stage, "run_stubborn")
    pid = until(lambda: _pid(dispatcher, "run_stubborn"))
    monkeypatch.setattr("workers.dispatcher.UNWANTED_S", 1.0)
    dispatcher.withdraw("run_stubborn")
    until(lambda: not Path(f"/proc/{pid}").exists(), 30)
    until(lambda: not dispatcher._jobs)


def test_a_lost_process_means_another_attempt_with_the_same_bytes(started):
    dispatcher, store = started
    stage = training(50, max_steps=3_000, evaluate_every=3_000)
    future = dispatcher.submit(stage, "run_lost")
    pid = until(lambda: _pid(dispatcher, "run_lost"))
    os.kill(pid, signal.SIGKILL)
    result = future.result(180)
    assert [c[1] for c in store.commits if c[0] == stage.digest] == [2]
    assert result.blobs == compute(stage).blobs


@pytest.mark.slow
def test_a_process_that_hangs_is_lost_as_well(started, monkeypatch):
    dispatcher, store = started
    stage = training(51, max_steps=15_000, evaluate_every=15_000)
    future = dispatcher.submit(stage, "run_hung")
    pid = until(lambda: _pid(dispatcher, "run_hung"))
    monkeypatch.setattr("workers.heartbeats.SILENT_S", 10.0)
    os.kill(pid, signal.SIGSTOP)
    assert future.result(180).blobs
    assert [c[1] for c in store.commits if c[0] == stage.digest] == [2]
    until(lambda: not Path(f"/proc/{pid}").exists())


@pytest.mark.slow
@pytest.mark.parametrize("is_cancelled", [False, True])
def test_a_process_that_hangs_before_its_first_sign_of_life_is_lost_as_well(
    started, monkeypatch, is_cancelled
):
    dispatcher, store = started
    until(lambda: not workers(dispatcher))  # who are warm would be taken
    monkeypatch.setattr("workers.heartbeats.FIRST_SIGN_S", 20.0)
    stage = training(520 + is_cancelled, max_steps=1_000, evaluate_every=1_000)
    future = dispatcher.submit(stage, "run_stopped")
    pid = until(lambda: next(iter(workers(dispatcher)), None))
    os.kill(pid, signal.SIGSTOP)
    if is_cancelled:
        dispatcher.withdraw("run_stopped")
        until(lambda: not dispatcher.activities("run_stopped") and not dispatcher._jobs)
    else:
        assert future.result(180).blobs
        assert [c[1] for c in store.commits if c[0] == stage.digest] == [2]
    until(lambda: not Path(f"/proc/{pid}").exists())


def workers(dispatcher):
    """Pids of processes that were started for actors of stages, however far they have come."""
    others = ("ray::Board", "ray::RuntimeEnvAgent", "ray::DashboardAgent")
    pids = []
    for process in psutil.Process().children(recursive=True):
        with suppress(psutil.NoSuchProcess):
            if process.parent().name() == "raylet" and not process.name().startswith(others):
                pids.append(process.pid)
    return pids


@pytest.mark.slow
def test_a_board_that_hangs_is_replaced(started):
    dispatcher, _ = started
    children = psutil.Process().children(recursive=True)
    (pid,) = [child.pid for child in children if child.name().startswith("ray::Board")]
    os.kill(pid, signal.SIGSTOP)
    stage = training(53, max_steps=20_000, evaluate_every=20_000)
    assert dispatcher.submit(stage, "run_board").result(180).blobs
    until(lambda: not Path(f"/proc/{pid}").exists())
    dispatcher.submit(long_training(54), "run_after")
    until(lambda: _pid(dispatcher, "run_after"))  # which the new board has reported
    dispatcher.withdraw("run_after")


@pytest.mark.slow
def test_a_process_lost_three_times_fails_the_stage(started):
    dispatcher, _ = started
    future = dispatcher.submit(long_training(60), "run_doomed")
    killed = set()
    while len(killed) < 3:
        pid = until(lambda: _pid(dispatcher, "run_doomed"))
        if pid not in killed:
            os.kill(pid, signal.SIGKILL)
            killed.add(pid)
    with pytest.raises(StageFailed, match="lost 3 times") as failed:
        future.result(120)
    assert failed.value.cause == "worker_lost"


def test_a_stage_that_goes_wrong_says_how_and_is_not_remembered(started):
    dispatcher, store = started
    stage = evaluation(policy=b"", task="nothing")
    with pytest.raises(StageFailed, match="there is no task 'nothing'") as failed:
        dispatcher.submit(stage, "run_wrong").result(60)
    assert failed.value.cause == "unknown_name"
    assert stage.digest not in store.results
    defect = replace(training(90), training=None)
    with pytest.raises(StageFailed, match="AttributeError") as failed:
        dispatcher.submit(defect, "run_wrong").result(60)
    assert failed.value.cause == "internal"


def test_a_result_that_cannot_be_stored_fails_its_stage_and_nobody_elses(started):
    dispatcher, store = started
    with pytest.raises(StageFailed, match="no space left") as failed:
        dispatcher.submit(training(70), "run_unlucky").result(60)
    assert failed.value.cause == "not_stored"
    until(lambda: training(70).digest in store.dropped)
    assert dispatcher.is_alive
    assert dispatcher.submit(training(71), "run_lucky").result(60)


@pytest.mark.parametrize(("seed", "when"), [(72, "looked up"), (73, "stored")])
def test_a_stage_waits_for_a_database_that_cannot_be_used_just_now(started, seed, when):
    dispatcher, store = started
    if when == "stored":
        stage = training(seed, max_steps=4000)
        asked = dispatcher.submit(stage, "run_patient")
        until(lambda: running(dispatcher, "run_patient"))
        store.refusals = 2
    else:
        store.refusals, stage = 2, training(seed)
        asked = dispatcher.submit(stage, "run_patient")
    assert asked.result(60).blobs
    assert store.refusals == 0
    assert [commit[:2] for commit in store.commits if commit[0] == stage.digest] == [
        (stage.digest, 1)  # computed once
    ]


def test_a_run_on_two_cores_has_the_same_events_as_in_this_process(started):
    """Events may come in another order where stages run at the same time."""
    dispatcher, _ = started
    spec = RunSpec.model_validate({"task": "arm", "method": "udr", "preset": "smoke"})
    there = list(run(spec, RayStages("run_whole", dispatcher, lambda: False)))
    here = list(run(spec, LocalStages()))
    assert sorted(e.model_dump_json() for e in there) == sorted(e.model_dump_json() for e in here)


def test_a_cancelled_run_stops_at_its_next_stage(started):
    dispatcher, _ = started
    flag = threading.Event()
    spec = RunSpec.model_validate({"task": "arm", "method": "simopt", "preset": "smoke", "seed": 9})
    program = run(spec, RayStages("run_cancelled", dispatcher, flag.is_set))
    next(program)
    flag.set()
    with pytest.raises(RunCancelled):
        list(program)


def _pid(dispatcher, run_id):
    """The process that works for a run, once it has given a sign of life."""
    return next((a.pid for a in running(dispatcher, run_id) if a.pid), None)
