"""The mean of a policy's weights."""

import numpy as np
import pytest

from adr_service.tasks.catalogue import get_task
from adr_service.training.average import Average
from adr_service.training.policy import Policy

ARM = get_task("arm")


def policy(value):
    layer = (np.full((2, 4), value, np.float32), np.full(2, -value, np.float32))
    return Policy((layer,), "relu", ARM.action_low, ARM.action_high, "clip")


def test_the_mean_of_equal_policies_is_that_policy():
    average = Average(100)
    for done in range(0, 500, 10):
        found = average.add(policy(0.3), done)
    assert found.to_bytes() == policy(0.3).to_bytes()


def test_a_policy_weighs_less_the_longer_ago_it_was():
    average = Average(100)
    for done in range(0, 1000, 5):
        average.add(policy(1.0), done)
    for done in (1050, 1100, 1200):
        ((weight, bias),) = average.add(policy(0.0), done).layers
        np.testing.assert_allclose(weight, np.exp(-(done - 995) / 100), rtol=1e-3)
        np.testing.assert_allclose(bias, -np.exp(-(done - 995) / 100), rtol=1e-3)


def test_the_first_policy_counts_no_more_than_the_others():
    """The later of two policies has a little more than half of the weight."""
    average = Average(100)
    average.add(policy(1.0), 0)
    ((weight, _),) = average.add(policy(0.0), 5).layers
    np.testing.assert_allclose(weight, 1 / (1 + np.exp(0.05)), rtol=1e-6)


def test_the_first_policy_counts_no_more_where_evaluations_come_sooner():
    """Three policies count about alike; the first one's weights are 1, the others' are 0."""
    average = Average(10**6, at_least_every=240)
    assert average.is_due(12)
    average.add(policy(1.0), 12)
    assert not average.is_due(200)
    average.add(policy(0.0), 240)
    ((weight, _),) = average.add(policy(0.0), 480).layers
    np.testing.assert_allclose(weight, 252 / 720, rtol=1e-3)


def test_the_mean_of_noisy_weights_is_closer_to_their_centre():
    """By exponential weights over 20 samples, the variance falls to a 40th."""
    rng, average = np.random.default_rng(0), Average(1000)
    found = []
    for done in range(0, 200_000, 50):
        ((weight, _),) = average.add(policy(rng.normal()), done).layers
        found.append(weight[0, 0])
    assert np.std(found[200:]) == pytest.approx(np.sqrt(1 / 40), rel=0.1)


def test_a_policy_is_due_twenty_times_in_the_steps_that_are_averaged():
    average = Average(100)
    assert average.is_due(0)
    average.add(policy(1.0), 0)
    assert not average.is_due(4)
    assert average.is_due(5)


def test_a_policy_that_was_added_is_not_changed_later():
    average, first = Average(100), policy(1.0)
    mean = average.add(first, 0)
    average.add(policy(0.0), 100)
    assert first.to_bytes() == mean.to_bytes() == policy(1.0).to_bytes()
