"""Proposals of BayRn as stages."""

from dataclasses import replace

import numpy as np
import pytest

from adr_service.distributions import Uniform
from adr_service.errors import InvalidInput
from adr_service.methods.base import Proposal
from adr_service.methods.bayrn import BayRn, BayRnSettings
from adr_service.methods.udr import UdrSettings, random_bounds
from adr_service.randomness import stream
from adr_service.stages.base import compute
from adr_service.stages.propose import Propose
from tests.planted import SPACE
from tests.stages.examples import Speed

RETURNS = [0.0, 5.0, 1.0, 2.0]
STAGE = Propose(
    task="arm",
    variant="vanilla",
    seed=0,
    method=BayRnSettings(initial=4).model_dump(exclude={"report"}),
    distributions=random_bounds(SPACE, UdrSettings(policies=4), stream("boxes")),
    returns=RETURNS,
)


@pytest.fixture(scope="module")
def proposed():
    return STAGE.read(compute(STAGE))


def test_the_next_distribution_is_new_and_in_the_space_of_the_variant(proposed):
    assert isinstance(proposed.distribution, Uniform)
    assert proposed.distribution.space == STAGE.space == SPACE
    known = [box.to_json() for box in STAGE.distributions]
    assert proposed.distribution.to_json() not in known


def test_the_best_is_the_one_with_the_highest_posterior_mean(proposed):
    means = proposed.diagnostics["posterior_means"]
    assert proposed.best == np.argmax(means) == np.argmax(RETURNS)
    assert proposed.diagnostics["reported"] == proposed.best
    assert proposed.diagnostics["returns_seen"] == RETURNS


def test_it_simulates_nothing_and_costs_the_same_on_any_core(proposed):
    assert proposed.simulated_steps == 0
    slow, fast = (STAGE.cost(Speed(rate)) for rate in (1.0, 1e6))
    assert slow == fast
    assert slow.target_transitions == 0


@pytest.mark.parametrize("best", [4, -1])
def test_a_best_policy_that_was_not_tried_is_refused(monkeypatch, best):
    wrong = Proposal(STAGE.distributions[0], best=best)
    monkeypatch.setattr(BayRn, "propose", lambda *_: wrong)
    with pytest.raises(InvalidInput, match=f"a number from 0 to 3; given {best}"):
        compute(STAGE)


def test_a_distribution_over_the_parameters_in_another_order_is_refused(monkeypatch):
    turned = SPACE.subset(SPACE.names[::-1])
    wrong = Proposal(Uniform(turned, turned.low, turned.high), best=0)
    monkeypatch.setattr(BayRn, "propose", lambda *_: wrong)
    with pytest.raises(InvalidInput, match="the distribution of bayrn is over elbow_friction, "):
        compute(STAGE)


def test_a_stand_in_reports_the_latest_and_differs_by_digest():
    other = replace(STAGE, seed=1)
    assert STAGE.stand_in().best == len(RETURNS) - 1
    assert STAGE.stand_in().distribution.to_json() != other.stand_in().distribution.to_json()
