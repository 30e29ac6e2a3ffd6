"""All programs: the same numbers every time, interrupted or not."""

import itertools

import pytest

from adr_service.programs import run
from adr_service.stages.local import LocalStages
from tests.programs.smoke import iterations, smoke


@pytest.mark.anew
def test_a_run_repeats_to_the_last_digit():
    first, second = (list(run(smoke("dropo"), LocalStages())) for _ in range(2))
    assert first == second


def test_a_run_over_finished_stages_computes_nothing_and_says_the_same():
    stages = LocalStages()
    first = list(run(smoke("simopt"), stages))
    count = len(stages.executed)
    assert list(run(smoke("simopt"), stages)) == first
    assert len(stages.executed) == count


def test_a_run_interrupted_anywhere_ends_the_same():
    whole = list(run(smoke("simopt"), LocalStages()))
    for cut in range(1, len(whole)):
        stages = LocalStages()
        began = list(itertools.islice(run(smoke("simopt"), stages), cut))
        assert began == whole[:cut]
        assert list(run(smoke("simopt"), stages)) == whole


def test_seeds_differ():
    zero, one = (iterations(smoke("prior", seed=seed), LocalStages()) for seed in (0, 1))
    assert zero[0].returns != one[0].returns


@pytest.mark.parametrize("variant", ["noisy", "unmodeled"])
@pytest.mark.parametrize("method", ["simopt", "dropo", "oracle"])
def test_every_variant_runs(variant, method):
    final = iterations(smoke(method, variant=variant), LocalStages())[-1]
    assert final.target_rollouts == (0 if method == "oracle" else 1)
