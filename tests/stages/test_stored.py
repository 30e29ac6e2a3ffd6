"""Stages that answer with stored results alone."""

import pytest

from adr_service.stages.local import drained
from adr_service.stages.stored import ResultMissing, StoredStages
from tests.contracts.canned import canned
from tests.stages.examples import evaluation


def test_stored_results_are_answered_in_order():
    stages = [evaluation(n) for n in (2, 1)]
    store = {stage.digest: canned(stage) for stage in stages}
    stored = StoredStages("run_a", store.get)
    results = drained(stored.all(stages))
    assert results == [stage.read(store[stage.digest]) for stage in stages]
    assert stored.asked == stages


def test_a_missing_result_ends_the_program_after_those_that_are_there():
    there, missing = evaluation(1), evaluation(2)
    stored = StoredStages("run_a", {there.digest: canned(there)}.get)
    program = stored.all([missing, there])
    assert next(program).digest == there.digest
    with pytest.raises(ResultMissing, match="1 results are missing"):
        next(program)
    assert stored.asked == [there]
