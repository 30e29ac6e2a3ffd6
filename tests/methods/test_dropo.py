"""DROPO's likelihood, search space, searches and costs."""

from dataclasses import replace

import numpy as np
import pytest
from pydantic import ValidationError
from scipy import stats

from adr_service.distributions import normalised_std
from adr_service.errors import InvalidInput
from adr_service.methods import dropo
from adr_service.methods.dropo import (
    Dropo,
    DropoSettings,
    EDropoSettings,
    Likelihood,
    decode,
    log_likelihood,
)
from adr_service.progress import silent
from adr_service.randomness import stream
from adr_service.simulation.replay import Replay
from tests.planted import ARM, PROBLEM, SOURCE, SPACE, recorded, waving_policy


def fit(data, name, **settings):
    return Dropo(DropoSettings(**settings)).fit(PROBLEM, data, stream(name), silent)


class TestLikelihood:
    rng = np.random.default_rng(0)
    predictions, targets = rng.normal(size=(20, 7, 3)), rng.normal(size=(7, 3))

    def test_the_likelihood_is_scipys(self):
        expected = sum(
            stats.multivariate_normal.logpdf(
                self.targets[w],
                self.predictions[:, w].mean(axis=0),
                np.cov(self.predictions[:, w].T) + 1e-3 * np.eye(3),
            )
            for w in range(7)
        )
        given = log_likelihood(self.predictions, self.targets, 1e-3)
        assert given == pytest.approx(expected, rel=1e-10)

    def test_windows_are_independent(self):
        parts = [
            log_likelihood(self.predictions[:, w : w + 1], self.targets[w : w + 1], 1e-3)
            for w in range(7)
        ]
        whole = log_likelihood(self.predictions, self.targets, 1e-3)
        assert whole == pytest.approx(sum(parts), rel=1e-12)

    def test_the_order_of_draws_does_not_matter(self):
        turned = log_likelihood(self.predictions[::-1], self.targets, 1e-3)
        assert turned == pytest.approx(log_likelihood(self.predictions, self.targets, 1e-3))

    def test_draws_that_agree_leave_epsilon_as_the_variance(self):
        alike = np.repeat(self.predictions[:1], 20, axis=0)
        expected = stats.norm.logpdf(self.targets, alike[0], np.sqrt(1e-3)).sum()
        assert log_likelihood(alike, self.targets, 1e-3) == pytest.approx(expected, rel=1e-10)


class TestSearchSpace:
    def test_it_spans_means_and_log_deviations(self):
        lowest = decode(SPACE, np.zeros(8))
        highest = decode(SPACE, np.full(8, 4.0))
        np.testing.assert_allclose(lowest.mean, SPACE.low)
        np.testing.assert_allclose(lowest.std, 1e-5)
        np.testing.assert_allclose(highest.mean, SPACE.high)
        np.testing.assert_allclose(highest.std, (SPACE.high - SPACE.low) / 4)

    def test_the_middle_has_the_geometric_mean_of_the_deviations(self):
        middle = decode(SPACE, np.full(8, 2.0))
        np.testing.assert_allclose(middle.mean, (SPACE.low + SPACE.high) / 2)
        np.testing.assert_allclose(middle.std, np.sqrt(1e-5 * (SPACE.high - SPACE.low) / 4))


class TestWideDraws:
    """Three columns that move together by some 1e7, so that rounding loses the epsilon."""

    epsilon, targets = 1e-6, np.zeros((20, 3))
    levels = np.random.default_rng(0).random((40, 4))

    def predict(self, draws):
        line = 1e7 * draws @ np.random.default_rng(1).random((4, 20))
        return np.stack([line, 1.7 * line, -0.3 * line], axis=2)

    def test_they_have_no_likelihood(self):
        predictions = self.predict(self.levels)
        assert log_likelihood(predictions, self.targets, self.epsilon) == -np.inf
        assert np.isfinite(log_likelihood(predictions, self.targets, 1e6))

    @pytest.mark.parametrize("bonus", [0.0, 0.5])
    def test_they_are_counted_with_the_diverged(self, bonus):
        likelihood = Likelihood(SPACE, self.levels, self, self.epsilon, bonus)
        wide = likelihood.evaluate(SPACE.denormalise(np.full(4, 2.0)), np.ones(4))
        assert wide.loss == np.inf
        assert (likelihood.evaluations, likelihood.diverged) == (1, 1)


class TestCost:
    @pytest.mark.parametrize("search", ["trust_region", "cma_es"])
    def test_the_estimate_reports_all_that_was_simulated(self, search):
        data = recorded(waving_policy())
        settings = {"budget": 30, "samples_per_parameter": 2, "epsilon": 1e-4}
        estimate = fit(data, "cost", search=search, **settings)
        evaluations = estimate.diagnostics["evaluations"]
        assert evaluations < 30 + 20  # CMA-ES evaluates whole generations
        assert estimate.simulated_steps == evaluations * 8 * len(data)

    def test_windows_of_several_steps_cost_all_their_steps(self):
        data = recorded(waving_policy(), steps=20)
        found = fit(data, "lambda", steps=3, budget=5, samples_per_parameter=2, epsilon=1e-4)
        assert found.simulated_steps == found.diagnostics["evaluations"] * 8 * (20 // 3) * 3

    @pytest.mark.parametrize("noise", [0.0, 0.03])
    def test_a_trust_region_search_costs_at_most_what_was_planned(self, noise):
        """Noise makes the loss rough, and the search long."""
        data = recorded(waving_policy(), steps=20, noise=noise, seed=2)
        settings = DropoSettings(epsilon=1e-5, samples_per_parameter=3)
        estimate = Dropo(settings).fit(PROBLEM, data, stream("plan"), silent)
        planned = settings.planned_steps(len(SPACE), len(data))
        assert planned / 8 < estimate.simulated_steps <= planned

    def test_a_search_by_cma_es_costs_its_budget(self):
        data = recorded(waving_policy(), steps=20)
        settings = DropoSettings(budget=60, epsilon=1e-5, search="cma_es", samples_per_parameter=3)
        estimate = Dropo(settings).fit(PROBLEM, data, stream("plan"), silent)
        planned = settings.planned_steps(len(SPACE), len(data))
        assert planned <= estimate.simulated_steps < 1.25 * planned  # whole generations


class TestSearches:
    data = recorded(waving_policy(), steps=60, noise=0.003)

    def estimate(self, search, budget):
        settings = {"samples_per_parameter": 3, "epsilon": 2e-5}
        return fit(self.data, "exact", search=search, budget=budget, **settings)

    def test_the_trust_region_finds_as_good_an_optimum_as_cma_es(self):
        """By the loss on the same draws, where CMA-ES has 20 times as many evaluations.

        The tolerance is a fiftieth of a nat per window.
        """
        ours, papers = self.estimate("trust_region", 40), self.estimate("cma_es", 800)
        assert ours.diagnostics["loss_per_window"] < papers.diagnostics["loss_per_window"] + 0.02

    def test_the_path_has_each_loss_and_the_loss_that_was_predicted(self):
        facts = self.estimate("trust_region", 40).diagnostics
        assert len(facts["path"]) == facts["evaluations"]
        assert min(step["loss_per_window"] for step in facts["path"]) == facts["loss_per_window"]
        predicted = facts["predicted_loss_per_window"]
        assert predicted == pytest.approx(facts["loss_per_window"], abs=0.01)


def test_a_parameter_at_its_bound_is_recovered():
    """No draw around the middle of the box is as light as this forearm."""
    light = np.array([1.6, SPACE.low[1], 3.0, 2.0])
    estimate = fit(recorded(waving_policy(), light), "bound", epsilon=1e-5)
    np.testing.assert_allclose(estimate.distribution.mean, light, rtol=0.01)
    assert estimate.diagnostics["widest"] == []


def test_deviations_at_their_largest_are_named():
    """The simulator has no such noise, and epsilon is smaller than it."""
    noisy = recorded(waving_policy(), noise=0.3)
    widest = fit(noisy, "wide", epsilon=1e-6).diagnostics["widest"]
    assert widest
    assert set(widest) <= set(SPACE.names)


def test_the_reported_error_is_that_of_the_estimated_mean():
    data = recorded(waving_policy(), steps=20)
    estimate = fit(data, "error", budget=100, samples_per_parameter=2, epsilon=1e-6)
    predictions = Replay(ARM, SOURCE, data, 1, 1).predict(estimate.distribution.mean[None])[0]
    expected = np.mean(np.sum((predictions - data.next_observations) ** 2, axis=1))
    assert estimate.diagnostics["mean_squared_error"] == pytest.approx(expected)


@pytest.mark.parametrize("search", ["trust_region", "cma_es"])
def test_a_bonus_is_the_entropy_once_for_every_window(search):
    data = recorded(waving_policy(), noise=0.003, steps=20)
    settings = EDropoSettings(
        epsilon=1e-4, entropy=0.1, samples_per_parameter=2, budget=20, search=search
    )
    found = settings.create().fit(PROBLEM, data, stream("bonus"), silent)
    levels = stats.qmc.LatinHypercube(4, rng=stream("bonus")).random(8)  # the search's own
    likelihood = Likelihood(SPACE, levels, Replay(ARM, SOURCE, data, 1, 1), 1e-4)
    without = likelihood.evaluate(found.distribution.mean, found.distribution.std)
    entropy = float(np.log(normalised_std(found.distribution)).sum())
    assert abs(entropy) > 1
    expected = without.loss / 20 - 0.1 * entropy
    assert found.diagnostics["loss_per_window"] == pytest.approx(expected)


def test_several_epsilons_are_several_settings():
    several = DropoSettings(epsilon=[1e-5, 1e-3])
    assert [settings.epsilon for settings in several.each] == [1e-5, 1e-3]


def test_a_value_of_epsilon_is_tried_once():
    with pytest.raises(ValidationError, match="every value is tried once"):
        DropoSettings(epsilon=[1e-5, 1e-5])


def test_a_search_with_several_epsilons_is_refused():
    with pytest.raises(InvalidInput, match=r"one epsilon; given \[1e-05, 0.001\]"):
        Dropo(DropoSettings(epsilon=[1e-5, 1e-3]))


def test_windows_longer_than_the_recording_are_refused():
    data = recorded(waving_policy(), steps=20)
    with pytest.raises(InvalidInput, match="21 consecutive transitions"):
        fit(data, "long", steps=21, epsilon=1e-4)


@pytest.mark.parametrize(
    ("losses", "told"), [([1e13, np.inf, 3e13], [1e13, 6e13, 3e13]), ([1.0, np.inf], [1.0, 1e12])]
)
def test_cma_es_tells_large_losses_apart_and_infinite_ones_from_them(losses, told):
    """All from 1e12 on were one loss, among which it wandered about."""
    assert dropo._finite(losses) == told


@pytest.mark.parametrize(
    ("search", "match"),
    [
        ("cma_es", "candidates diverged in simulation"),
        ("trust_region", "simulation diverged for draws around"),
    ],
)
def test_a_search_whose_candidates_all_diverge_says_so(search, match):
    data = recorded(waving_policy(), steps=5)
    absurd = data.observations.copy()
    absurd[:, 2:] = 1e9
    settings = {"budget": 20, "samples_per_parameter": 2, "epsilon": 1e-4}
    with pytest.raises(InvalidInput, match=match):
        fit(replace(data, observations=absurd), "absurd", search=search, **settings)
