"""Evaluations on the simulated target."""

from dataclasses import replace

import numpy as np
import pytest
from threadpoolctl import threadpool_limits

from adr_service.errors import InvalidInput
from adr_service.progress import silent
from adr_service.stages.base import StageResult, compute
from adr_service.stages.evaluate import Evaluate
from adr_service.tasks.catalogue import get_task
from tests.planted import still_policy, waving_policy
from tests.stages.examples import UNSTABLE, Speed

STAGE = Evaluate(
    task="arm", variant="vanilla", episodes=6, seed=0, policy=waving_policy().to_bytes()
)


def test_there_is_one_return_per_episode_and_no_two_are_equal():
    result = STAGE.read(compute(STAGE))
    assert len(set(result.returns)) == STAGE.episodes
    assert result.diverged_episodes == 0


def test_returns_do_not_depend_on_the_callers_number_of_threads():
    """OpenBLAS gives a product of this size other last bits on two threads than on one."""
    stage = replace(STAGE, episodes=100, policy=waving_policy(units=128).to_bytes())
    results: list[StageResult] = []
    for threads in (1, 2):
        with threadpool_limits(threads):
            results.append(compute(stage))
    assert results[0] == results[1]


def test_diverged_episodes_are_counted_and_have_a_finite_return():
    policy = still_policy(get_task("half_cheetah")).to_bytes()
    stage = replace(STAGE, **UNSTABLE, policy=policy)
    result = stage.read(compute(stage))
    assert result.diverged_episodes == stage.episodes
    assert np.all(np.isfinite(result.returns))


def test_the_noisy_target_earns_another_return_from_the_same_starts():
    """The policy acts on what it measures."""
    clean, noisy = (
        replace(STAGE, variant=variant).compute(np.random.default_rng(0), silent).returns
        for variant in ("vanilla", "noisy")
    )
    assert np.all(np.array(clean) != noisy)


def test_bytes_that_are_no_policy_are_refused():
    with pytest.raises(InvalidInput, match="not the bytes of a policy"):
        compute(replace(STAGE, policy=b"weights"))


def test_its_cost_is_proportional_to_the_episodes_and_not_metered():
    cost = STAGE.cost(Speed(100.0))
    assert cost.seconds == 6 * get_task("arm").horizon / 100
    assert cost.target_transitions == 0
    assert STAGE.stand_in().returns == [0.0] * 6
