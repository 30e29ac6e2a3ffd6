"""The words and bars in which a page shows the events and stages of a run."""

import pytest

from adr_service.benchmark.cost import Execution
from adr_service.events import IterationFinished, RunFailed, RunSucceeded, StageFinished
from api.page.runs import chosen_of, timeline, untrained, words_of


def stage(asked, placed, began, ended, preparing=None):
    return "evaluate", Execution(
        attempt=1,
        started_by="run_0",
        asked=asked,
        placed=placed,
        began=began,
        ended=ended,
        preparing=preparing,
    )


def test_a_bar_has_the_time_of_waiting_of_starting_and_of_computing():
    (bar,) = timeline([stage(10.0, 12.0, 13.0, 20.0, preparing=1.0)], 0.0).bars
    parts = {part.name: (part.start, part.width) for part in bar.parts}
    assert parts["waits"] == pytest.approx((0.0, 0.2))
    assert parts["starts"] == pytest.approx((0.2, 0.2))
    assert parts["computes"] == pytest.approx((0.4, 0.6))


def test_only_the_latest_stages_are_drawn_and_the_others_counted():
    drawn = timeline([stage(i, i, i, i + 1.0) for i in range(100)], 0.0)
    assert (len(drawn.bars), drawn.left_out) == (80, 20)
    assert timeline([], 0.0).bars == []
    shared = timeline([stage(1.0, 1.0, 1.0, 2.0), stage(9.0, 9.0, 9.0, 10.0)], 5.0)
    assert (len(shared.bars), shared.left_out) == (1, 1)


def test_events_are_told_in_words():
    finished = IterationFinished(
        iteration=2,
        target_rollouts=2,
        target_transitions=400,
        evaluation_episodes=2,
        distributions=[],
        policies=[],
        source_returns=[],
        reached_threshold=[],
        training_steps=[],
        inference_steps=0,
        returns=[[1.0, 3.0]],
        diagnostics={},
    )
    assert words_of(finished) == "iteration 2, 400 transitions seen, target return 2"
    unevaluated = finished.model_copy(update={"returns": []})
    assert words_of(unevaluated) == "iteration 2, 400 transitions seen"
    assert words_of(StageFinished(kind="infer", digest="a" * 64)) == "infer aaaaaaaa"
    assert words_of(RunFailed(submission=1, code="x", message="why")) == "why"
    assert words_of(RunSucceeded()) == ""


def test_the_causes_that_no_training_simulates_are_named():
    """A verdict of an older version may have kinds that are gone."""
    kinds = ("actuator_gain", "sensor_delay", "actuator_lag", "gone_since", "sensor_delay")
    verdict = {"causes": [{"kind": kind} for kind in kinds]}
    assert untrained(verdict) == ["sensor_delay", "actuator_lag"]


@pytest.mark.parametrize(
    ("tried", "words"),
    [
        ({"1e-06": 3.0, "0.0001": 1.0, "0.01": 2.0}, "epsilon 0.0001"),
        ({"1e-06": 3.0, "0.0001": None, "0.01": 2.0}, "epsilon 0.01, the last of those tried"),
        ({"1e-06": 1.0, "0.0001": 0.998, "0.01": 0.995}, "epsilon 1e-06"),  # they predict alike
        ({"0.01": 2.0}, ""),
        ("anything", ""),
    ],
)
def test_the_chosen_of_several_settings_is_named_and_whether_it_is_the_last(tried, words):
    assert chosen_of({"loss": 1.0, "mean_squared_error_by_epsilon": tried}) == words
