"""DROID's search, its costs and its diagnostics."""

from dataclasses import replace

import numpy as np
import pytest
from pydantic import ValidationError

from adr_service.distributions import Gaussian
from adr_service.errors import InvalidInput
from adr_service.methods.droid import Droid, DroidSettings, _ranked
from adr_service.progress import silent
from adr_service.randomness import stream
from tests.planted import PROBLEM, SPACE, distance, recorded, waving_policy

DATA = recorded(waving_policy())


def fit(data=DATA, stream_name="droid", **settings):
    return Droid(DroidSettings(**settings)).fit(PROBLEM, data, stream(stream_name), silent)


def test_the_answer_is_the_searchs_own_gaussian_and_narrows_with_the_budget():
    early, late = (fit(budget=budget) for budget in (80, 600))
    assert isinstance(early.distribution, Gaussian)
    assert np.all(late.distribution.std < 0.1 * early.distribution.std)


def test_diagnostics_count_whole_populations_and_the_steps_they_cost():
    estimate = fit(budget=30)
    evaluations = estimate.diagnostics["evaluations"]
    assert 30 <= evaluations < 30 + 8  # 4 + floor(3 ln 4) candidates in a population
    assert estimate.simulated_steps == evaluations * len(DATA)
    assert estimate.diagnostics["diverged_replays"] == 0
    assert estimate.diagnostics["stopped_by"] == []


def test_reported_deviations_are_the_distributions_in_search_coordinates():
    estimate = fit(budget=30)
    scale = (SPACE.high - SPACE.low) / SPACE.WIDTH
    expected = estimate.distribution.std / scale
    np.testing.assert_allclose(estimate.diagnostics["std"], expected, rtol=1e-12)


def test_a_larger_budget_ends_at_a_lower_cost():
    costs = [fit(budget=budget).diagnostics["last_best_cost"] for budget in (16, 160)]
    assert 0 < costs[1] < costs[0]


def test_episodes_are_replayed_from_their_own_initial_states():
    """From the first one's state, the second could match no dynamics."""
    both = recorded(waving_policy(), episodes=2, steps=20)
    estimate = fit(both, budget=400)
    assert distance(estimate.distribution.mean) < 0.1


def test_rows_that_do_not_follow_one_another_are_refused():
    order = np.random.default_rng(0).permutation(len(DATA))
    arrays = ("observations", "actions", "next_observations")
    shuffled = replace(DATA, **{name: getattr(DATA, name)[order] for name in arrays})
    with pytest.raises(InvalidInput, match="need rows that follow one another"):
        fit(shuffled, budget=30)


def test_a_search_whose_candidates_all_diverge_says_so():
    """Recorded velocities beyond any robot's make every simulation diverge."""
    absurd = DATA.observations.copy()
    absurd[:, 2:] = 1e9
    with pytest.raises(InvalidInput, match="all 8 candidates of a population diverged"):
        fit(replace(DATA, observations=absurd), budget=30)


def test_a_replay_that_diverges_is_worse_than_all_others():
    assert _ranked(np.array([1.0, np.nan, 3.0])).tolist() == [1.0, 30.0, 3.0]


def test_deviations_that_the_search_would_not_take_are_refused():
    """CMA-ES keeps below a third of the box, whatever it is given."""
    with pytest.raises(ValidationError, match=r"less than or equal to 1\.33"):
        DroidSettings(initial_std=2.0)


def test_by_default_the_budget_grows_with_the_parameters():
    assert DroidSettings().planned_steps(8, 10) == 2 * DroidSettings().planned_steps(4, 10)
    assert DroidSettings(budget=7).planned_steps(8, 10) == 70
    evaluations = fit(data=DATA.first(10)).diagnostics["evaluations"]
    assert evaluations >= DroidSettings().planned_steps(len(SPACE), 1)
