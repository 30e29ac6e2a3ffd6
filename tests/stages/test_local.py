"""Stages in this process, one after the other."""

import pytest

from adr_service.errors import InvalidInput
from adr_service.stages.local import LocalStages, drained
from tests.generators import collect
from tests.planted import waving_policy
from tests.stages.examples import episode, evaluation

POLICY = waving_policy().to_bytes()
STAGES = [evaluation(seed, policy=POLICY) for seed in range(3)]


def test_results_and_events_are_in_the_order_of_the_stages():
    stages = LocalStages()
    events, results = collect(stages.all(STAGES))
    assert [event.digest for event in events] == [stage.digest for stage in STAGES]
    alone = [drained(LocalStages().run(stage)) for stage in STAGES]
    assert results == alone


def test_equal_stages_are_computed_once_and_each_has_its_event():
    stages = LocalStages()
    events, results = collect(stages.all([STAGES[0], STAGES[1], STAGES[0]]))
    assert stages.executed == STAGES[:2]
    assert len(events) == 3
    assert results[0] == results[2] != results[1]


def test_a_stage_of_an_earlier_request_is_not_computed_again():
    stages = LocalStages()
    first = drained(stages.run(STAGES[0]))
    events, again = collect(stages.run(evaluation(0, policy=POLICY)))
    assert again == first
    assert [event.key for event in events] == [f"stage_finished:{STAGES[0].digest}"]
    assert len(stages.executed) == 1


def test_a_stage_is_computed_only_when_its_event_is_asked_for():
    stages = LocalStages()
    program = stages.all(STAGES)
    assert stages.executed == []
    next(program)
    assert stages.executed == STAGES[:1]


def test_no_stages_have_no_results():
    assert collect(LocalStages().all([])) == ([], [])


def test_the_error_of_a_stage_ends_the_program_after_the_events_of_earlier_ones():
    program = LocalStages().all([STAGES[0], episode()])
    next(program)
    with pytest.raises(InvalidInput, match="an external target needs the service"):
        next(program)
