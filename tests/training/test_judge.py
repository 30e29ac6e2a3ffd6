"""The judge: what it keeps of noisy evaluations, and when a threshold is reached."""

import numpy as np
import pytest

from adr_service.distributions import Gaussian
from adr_service.tasks.catalogue import get_task, source_of
from adr_service.training.judge import Judge
from adr_service.training.policy import Policy
from tests.training.examples import settings

ARM, SOURCE = get_task("arm"), source_of("arm", "vanilla")
# the best of many evaluations by two episodes flatters; a confirmation by 400 does not
NOISY = {"evaluation_episodes": 2, "confirmation_episodes": 400}


def judge(algorithm="ppo", **others):
    rng = np.random.default_rng(0)
    given = settings(algorithm, **(NOISY | others if algorithm == "ppo" else {}))
    return Judge(ARM, SOURCE, Gaussian.prior(SOURCE.space), given, rng)


def still(push):
    """A policy of constant actions."""
    layer = (np.zeros((2, 4), np.float32), np.full(2, push, np.float32))
    return Policy((layer,), "relu", ARM.action_low, ARM.action_high)


def test_the_best_of_many_evaluations_is_reported_by_fresh_episodes():
    """All policies are the same, so what they return on average is known."""
    judging = judge()
    for step in range(40):
        judging.evaluate(still(0.1), step)
    returns = [point.mean_return for point in judging.curve]
    reported = judging.reported()
    assert max(returns) > np.mean(returns) + 3 * reported.standard_error
    spread = np.std(returns) / np.sqrt(len(returns))
    tolerance = 4 * np.hypot(reported.standard_error, spread)
    assert reported.mean_return == pytest.approx(np.mean(returns), abs=tolerance)


def test_sac_reports_its_best_evaluation_as_it_is():
    judging = judge("sac")
    for step in range(5):
        judging.evaluate(still(0.1), step)
    assert judging.reported() == max(judging.curve, key=lambda point: point.mean_return)


def test_asking_again_evaluates_nothing_again():
    judging = judge()
    judging.evaluate(still(0.1), 100)
    assert judging.reported() is judging.reported()
    assert judging.reported().steps == 100


def test_a_policy_that_only_seemed_better_does_not_stay_the_best(known):
    """Its fresh episodes stand in the place of the evaluation that flattered it."""
    judging = judge()
    lucky, good = still(0.1), still(0.1)
    while not judging.curve or judging.curve[-1].mean_return < 1.2 * known:
        judging.evaluate(lucky, 0)
    judging.reported()
    for step in range(20):
        judging.evaluate(good, step)
    assert judging.policy is good


@pytest.fixture(scope="module")
def known():
    """The mean return of the constant policy."""
    judging = judge()
    judging.evaluate(still(0.1), 0)
    return judging.reported().mean_return


@pytest.mark.parametrize("factor", [0.9, 1.2])
def test_a_threshold_is_reached_where_fresh_episodes_earn_it(known, factor):
    judging = judge()
    for step in range(40):
        judging.evaluate(still(0.1), step)
    assert max(point.mean_return for point in judging.curve) > 1.2 * known
    assert judging.has_reached(factor * known) == (factor < 1)


def test_a_mean_within_its_error_of_the_threshold_does_not_reach_it():
    judging = judge()
    judging.evaluate(still(0.1), 0)
    reported = judging.reported()
    assert judging.has_reached(reported.mean_return - 1.01 * reported.standard_error)
    assert not judging.has_reached(reported.mean_return - 0.99 * reported.standard_error)
