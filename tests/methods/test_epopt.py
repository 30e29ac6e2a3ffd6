"""EPOpt: which dynamics its phases draw."""

import numpy as np
import pytest

from adr_service.methods.epopt import EpOptSettings
from adr_service.randomness import stream
from tests.planted import PROBLEM, SPACE


def kinds_of(curriculum, moves, earned):
    """The kinds of distributions of the phases, and the draws of each."""
    rng, kept = stream("epopt"), []
    for _ in range(moves):
        dynamics = curriculum.sample(50, rng).values
        kept.append((curriculum.distribution.to_json()["kind"], dynamics))
        curriculum.move(dynamics, earned(dynamics))
    return kept


def test_after_the_first_phases_most_draw_from_the_worst_dynamics_of_one():
    curriculum = EpOptSettings(skip=2, focus=3, epsilon=0.1).create(PROBLEM)
    kept = kinds_of(curriculum, 11, lambda dynamics: -dynamics[:, 0])
    kinds = [kind for kind, _ in kept]
    assert kinds == ["uniform"] * 3 + ["empirical"] * 3 + ["uniform"] + ["empirical"] * 3 + [
        "uniform"
    ]
    measured, focused = kept[2][1], kept[3][1]
    assert len(np.unique(focused, axis=0)) == 5
    worst = np.sort(measured[:, 0])[-5:]
    np.testing.assert_array_equal(np.unique(focused[:, 0]), worst)


@pytest.mark.parametrize(("epsilon", "count"), [(0.28, 14), (1e-12, 1)])
def test_a_share_of_episodes_that_is_a_whole_number_is_that_number(epsilon, count):
    """.28 * 50 is 14.000000000000002 in floats; of no share one episode is left."""
    curriculum = EpOptSettings(skip=0, epsilon=epsilon).create(PROBLEM)
    dynamics = curriculum.sample(50, stream("epopt")).values
    curriculum.move(dynamics, -dynamics[:, 0])
    assert len(curriculum.distribution.points) == count


def test_the_worst_are_measured_anew_in_each_turn():
    curriculum = EpOptSettings(skip=0, focus=1).create(PROBLEM)
    one, _, other = (draws for _, draws in kinds_of(curriculum, 4, lambda d: d[:, 1])[1:])
    assert not np.any(np.isin(one, other))


def test_the_whole_box_is_measured():
    curriculum = EpOptSettings().create(PROBLEM)
    share = (curriculum.sample(4000, stream("box")).values - SPACE.low) / (SPACE.high - SPACE.low)
    assert share.min() < 0.01
    assert share.max() > 0.99
