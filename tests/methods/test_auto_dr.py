"""AutoDR: how its episodes are drawn, and where its bounds go."""

from dataclasses import replace

import numpy as np
import pytest
from pydantic import ValidationError

from adr_service.methods.auto_dr import AutoDrSettings
from adr_service.methods.base import Problem
from adr_service.parameters import Parameter, ParameterSpace
from adr_service.randomness import stream
from tests.planted import PROBLEM, SPACE

THRESHOLD = PROBLEM.task.reward_threshold
RANGE = SPACE.high - SPACE.low


def bounds(curriculum):
    """Lower and upper bounds (2, d) in [0, 1]."""
    box = curriculum.distribution
    return (np.array([box.low, box.high]) - SPACE.low) / RANGE


def run(earned, moves, **settings):
    """The curriculum after moves; `earned` gives shares of the threshold from points in [0, 1]."""
    rng = np.random.default_rng(0)
    curriculum = AutoDrSettings(**settings).create(PROBLEM)
    for _ in range(moves):
        dynamics = curriculum.sample(128, rng).values
        curriculum.move(dynamics, THRESHOLD * earned((dynamics - SPACE.low) / RANGE))
    return curriculum


def test_the_first_box_is_one_step_wide_around_the_centre():
    first = bounds(run(lambda share: np.zeros(len(share)), moves=0, step=0.1))
    np.testing.assert_allclose(first, [[0.45] * len(SPACE), [0.55] * len(SPACE)])


def test_so_many_episodes_as_asked_for_have_one_parameter_at_a_bound():
    curriculum, n = AutoDrSettings(boundary=0.3).create(PROBLEM), 20_000
    values = curriculum.sample(n, np.random.default_rng(0)).values
    box = curriculum.distribution
    at_bound = (values == box.low) | (values == box.high)
    assert at_bound.sum(axis=1).max() == 1
    assert np.mean(at_bound.any(axis=1)) == pytest.approx(0.3, abs=4 * np.sqrt(0.21 / n))
    sides = [np.mean(values == bound, axis=0) for bound in (box.low, box.high)]
    np.testing.assert_allclose(sides, 0.3 / (2 * len(SPACE)), rtol=0.2)
    assert np.all((values >= box.low) & (values <= box.high))


def test_the_box_grows_to_the_search_bounds_where_the_policy_always_earns_enough():
    np.testing.assert_allclose(
        bounds(run(lambda share: np.ones(len(share)), 60)), [[0.0] * 4, [1.0] * 4], atol=1e-12
    )


def test_a_bound_moves_once_its_buffer_is_full():
    curriculum = AutoDrSettings(buffer=7, step=0.1).create(PROBLEM)
    middle = (SPACE.low + SPACE.high) / 2
    solved = np.full(64, 10 * THRESHOLD)
    curriculum.move(np.tile(middle, (64, 1)), solved)  # the first box is solved
    before = bounds(curriculum)
    at_bound = middle.copy()
    at_bound[0] = curriculum.distribution.high[0]
    curriculum.move(np.tile(at_bound, (6, 1)), solved[:6])
    np.testing.assert_array_equal(bounds(curriculum), before)
    curriculum.move(at_bound[None], solved[:1])
    assert bounds(curriculum)[1, 0] > before[1, 0]
    assert bounds(curriculum)[1, 1] == before[1, 1]


def test_bounds_stop_where_returns_fall():
    grown = bounds(run(lambda share: np.where(share[:, 0] < 0.7, 1.0, 0.0), moves=80))
    assert 0.6 < grown[1, 0] < 0.8
    np.testing.assert_allclose(np.delete(grown[1], 0), 1.0)
    np.testing.assert_allclose(grown[0], 0.0, atol=1e-12)


def test_returns_between_the_thresholds_move_nothing():
    curriculum, rng, kept = run(lambda share: np.ones(len(share)), moves=10), stream("between"), []
    for _ in range(20):
        dynamics = curriculum.sample(128, rng).values
        curriculum.move(dynamics, np.full(128, 0.5 * THRESHOLD))
        kept.append(bounds(curriculum))
    # the first of them are averaged with higher returns from before
    np.testing.assert_array_equal(kept[-1], kept[9])
    assert 0 < kept[-1][0].min() < kept[-1][1].max() < 1


def test_a_box_shrinks_under_a_policy_that_forgets_and_keeps_the_width_of_a_step():
    curriculum = run(lambda share: np.ones(len(share)), moves=20)
    rng = np.random.default_rng(1)
    for _ in range(60):
        dynamics = curriculum.sample(128, rng).values
        curriculum.move(dynamics, np.zeros(128))
    low, high = bounds(curriculum)
    np.testing.assert_allclose(high - low, 0.05)


def test_rounding_leads_no_bound_beyond_the_search_range():
    """(.2 + step) - step is a bit below .2, which cannot be simulated."""
    parameter = Parameter("mass", "body:forearm.mass", "kg", 0.2, 3.0, 0.2)
    step = 0.05 * (3.0 - 0.2)
    assert (0.2 + step) - step < 0.2
    source = replace(PROBLEM.source, space=ParameterSpace((parameter,)))
    curriculum, rng = AutoDrSettings().create(Problem(PROBLEM.task, source)), stream("bounds")
    curriculum.move(curriculum.sample(128, rng).values, np.full(128, THRESHOLD))
    for _ in range(60):
        dynamics = curriculum.sample(128, rng).values
        at_low = dynamics[:, 0] == curriculum.distribution.low[0]
        curriculum.move(dynamics, np.where(at_low, THRESHOLD, 0.0))
    assert curriculum.distribution.low[0] == 0.2


def test_rounding_leads_no_first_box_below_what_is_feasible():
    """The centre less half of this range is a bit below its lower end."""
    low, high = np.array([0.1, 0.2]), np.array([0.4, 0.5])
    assert np.all((low + high) / 2 - (high - low) / 2 < low)
    bounds_of = zip(SPACE.parameters, low, high, strict=False)
    parameters = [replace(p, low=a, high=b, feasible_low=a) for p, a, b in bounds_of]
    source = replace(PROBLEM.source, space=ParameterSpace(tuple(parameters)))
    box = AutoDrSettings(step=1.0).create(Problem(PROBLEM.task, source)).distribution
    assert (box.low.tolist(), box.high.tolist()) == (low.tolist(), high.tolist())


def test_nothing_moves_until_the_first_box_is_solved():
    untrained = run(lambda share: np.full(len(share), 0.7), moves=20)
    assert bounds(untrained).tolist() == bounds(AutoDrSettings().create(PROBLEM)).tolist()


def test_a_low_threshold_above_the_high_one_is_refused():
    with pytest.raises(ValidationError, match=r"low: 2.0 given, which is not below high, 0.1"):
        AutoDrSettings(low=2.0, high=0.1)
