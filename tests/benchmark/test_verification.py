"""Stages of an archive that are computed again."""

from dataclasses import replace

import numpy as np
import pytest

from adr_service.benchmark.replay import agree, replay_run
from adr_service.benchmark.verification import (
    INFERENCE_TOLERANCE,
    TOLERANCE,
    _deviation,
    sampled,
    tolerance,
    verify,
)
from adr_service.errors import InvalidInput
from adr_service.events import IterationFinished
from adr_service.npz import read_arrays, write_arrays
from adr_service.programs import run
from adr_service.randomness import stream
from adr_service.specs import RunSpec
from adr_service.stages.base import StageResult, compute
from adr_service.stages.target_rollout import TargetRollout
from adr_service.transitions import TransitionDataset
from tests.contracts.canned import CannedStages
from tests.stages.examples import evaluation, policy

SPEC = RunSpec.model_validate({"task": "arm", "method": "dropo", "preset": "smoke"})
STAGE = replace(evaluation(1, policy().to_bytes()), episodes=3)
ROLLOUT = TargetRollout(task="arm", variant="vanilla", transitions=10, iteration=0, seed=0)


@pytest.fixture(scope="module")
def stored():
    return compute(STAGE)


def changed(stored, by):
    """The result with its mean return larger by a share, and single ones by more."""
    returns = np.array(stored.values["returns"])
    returns += [10 * by, -10 * by, *[0.0] * (len(returns) - 2)]
    returns = (returns + by * max(1.0, abs(returns.mean()))).tolist()
    return StageResult({**stored.values, "returns": returns}, stored.blobs)


def all_results():
    """The stages of a run with canned results, by digest."""
    stages = CannedStages()
    list(run(SPEC, stages))
    return stages.results


def test_a_result_of_this_machine_is_identical(stored):
    verified = verify(STAGE, stored, True)
    assert (verified.agreement, verified.deviation, verified.kind) == ("identical", 0.0, "evaluate")


def test_on_the_same_machine_every_byte_counts(stored):
    assert verify(STAGE, changed(stored, 1e-12), True).agreement == "different"


def test_on_another_machine_numbers_may_differ_up_to_the_tolerance(stored):
    near = verify(STAGE, changed(stored, 0.9 * TOLERANCE), False)
    assert near.agreement == "close"
    assert near.deviation == pytest.approx(0.9 * TOLERANCE, rel=0.01)
    assert verify(STAGE, changed(stored, 1.1 * TOLERANCE), False).agreement == "different"


def test_inferences_may_differ_more_because_they_feed_on_chaotic_episodes():
    assert tolerance("infer") == INFERENCE_TOLERANCE > TOLERANCE == tolerance("evaluate")
    assert tolerance("target_rollout") == TOLERANCE


def test_a_result_of_another_form_is_different_everywhere(stored):
    for other in (
        StageResult({**stored.values, "evil": 1}, stored.blobs),
        StageResult({**stored.values, "returns": stored.values["returns"][1:]}, stored.blobs),
        StageResult(stored.values, {"evil": b""}),
    ):
        verified = verify(STAGE, other, False)
        assert (verified.agreement, verified.deviation) == ("different", np.inf)


def test_what_a_search_took_is_not_compared():
    """Rounding ended one after 195 replays in place of 198."""
    values = {"distribution": {"low": [3.99]}, "simulated_steps": 39_600}
    stored = StageResult({**values, "diagnostics": {"replays": 198}})
    other = StageResult({**values, "simulated_steps": 39_000, "diagnostics": {"replays": 195}})
    assert _deviation("infer", stored, other) == 0.0
    ends = {"path": [{"radius": 0.1}], "stopped_by": "converged"}, {"path": [], "stopped_by": "x"}
    searches = [StageResult({**values, "diagnostics": each}) for each in ends]
    assert _deviation("infer", *searches) == 0.0
    assert _deviation("target_rollout", stored, other) > TOLERANCE
    moved = StageResult({**stored.values, "distribution": {"low": [4.09]}})
    assert _deviation("infer", stored, moved) > INFERENCE_TOLERANCE


def test_arrays_within_blobs_are_compared_number_by_number():
    stored = compute(ROLLOUT)
    arrays = read_arrays(stored.blobs["data"], TransitionDataset.ARRAYS)
    arrays["observations"] = arrays["observations"] + 1e-6
    near = StageResult(stored.values, {"data": write_arrays(arrays)})
    verified = verify(ROLLOUT, near, False)
    assert verified.agreement == "close"
    assert 1e-7 < verified.deviation < 1.1e-6


def test_a_sample_has_different_stages_and_follows_the_seed():
    replay = replay_run("run_a", SPEC, all_results().get)
    twice = [replay, replay]
    one, two = (sampled(twice, 3, stream("test"), lambda stage: True) for _ in range(2))
    assert [s.digest for s in one] == [s.digest for s in two]
    assert len({s.digest for s in one}) == 3
    others = [sampled(twice, 3, stream("test", n), lambda stage: True) for n in range(20)]
    assert len({frozenset(stage.digest for stage in each) for each in others}) > 5
    everything = sampled(twice, 100, stream("test"), lambda stage: True)
    assert {s.digest for s in everything} == {s.digest for s in replay.stages}
    kinds = {s.kind for s in sampled(twice, 100, stream("test"), lambda s: s.role != "trainer")}
    assert "train_policy" not in kinds


def test_a_replay_ends_where_the_results_end():
    results = all_results()
    whole = replay_run("run_a", SPEC, results.get)
    assert whole.is_complete
    assert {stage.digest for stage in whole.stages} == set(results)
    missing = next(stage.digest for stage in whole.stages if stage.kind == "infer")
    part = replay_run("run_a", SPEC, lambda digest: None if digest == missing else results[digest])
    assert not part.is_complete
    assert part.events.items() < whole.events.items()


def test_a_result_that_breaks_the_program_is_refused_by_name():
    results = all_results()
    digest = next(s.digest for s in replay_run("run_a", SPEC, results.get).stages)
    results[digest] = StageResult({"evil": 1})
    with pytest.raises(
        InvalidInput, match="run_a cannot use a stored result: that of train_policy"
    ):
        replay_run("run_a", SPEC, results.get)


def test_events_that_the_results_do_not_lead_to_are_named():
    replay = replay_run("run_a", SPEC, all_results().get)
    assert replay.disagreements(replay.events) == []
    key = "iteration_finished:1"
    event = replay.events[key].model_copy(update={"training_steps": [1]})
    assert replay.disagreements({**replay.events, key: event}) == [key]
    extra = {**replay.events, "iteration_finished:9": event}
    assert replay.disagreements(extra) == ["iteration_finished:9"]
    part = replace(replay, is_complete=False)
    assert part.disagreements(extra) == []
    assert (part.is_behind(extra), part.is_behind(replay.events)) == (True, False)


def test_an_event_of_an_early_version_lacks_fields_and_is_no_other():
    replay = replay_run("run_a", SPEC, all_results().get)
    values = replay.events["iteration_finished:1"].model_dump(exclude={"inferences"})
    early = IterationFinished.model_validate(values)
    assert early.inferences != replay.events[early.key].inferences
    assert replay.disagreements({**replay.events, early.key: early}) == []
    other = IterationFinished.model_validate({**values, "inference_steps": -1})
    assert replay.disagreements({**replay.events, early.key: other}) == [early.key]


def test_stored_points_of_a_learning_curve_are_not_compared():
    """A training may have been interrupted, and repeated on another type of CPU."""
    replay = replay_run("run_a", SPEC, all_results().get)
    key = next(key for key in replay.events if key.startswith("training_evaluated"))
    moved = replay.events[key].model_copy(update={"mean_return": -1.0, "steps": 1})
    assert replay.disagreements({**replay.events, key: moved, moved.key: moved}) == []


def test_json_values_agree_up_to_rounding_alone():
    value = {"a": [1.0, {"b": "text"}], "c": None, "d": 3}
    assert agree(value, {"a": [1.0 + 1e-12, {"b": "text"}], "c": None, "d": 3})
    for other in (
        {**value, "a": [1.0 + 1e-6, {"b": "text"}]},
        {**value, "d": 4},
        {**value, "c": 0.0},
        {**value, "a": [1.0]},
        {"a": value["a"]},
    ):
        assert not agree(value, other)
