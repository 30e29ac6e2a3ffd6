"""Formulas against references, and planted truths recovered."""

import numpy as np
import pytest
from scipy import stats

from adr_service.distributions import Gaussian, TruncatedGaussian, Uniform
from adr_service.errors import InvalidInput
from adr_service.methods.base import Evidence, Problem
from adr_service.methods.dropo import Dropo, DropoSettings, decode, log_likelihood
from adr_service.methods.simopt import SimOpt, SimOptSettings, reps
from adr_service.methods.udr import UdrSettings, random_bounds
from adr_service.progress import silent
from adr_service.randomness import stream
from adr_service.simulation.batch import Simulations
from adr_service.simulation.rollout import run_episodes
from adr_service.tasks.catalogue import get_task, variants_of
from adr_service.training.policy import Policy
from adr_service.transitions import TransitionDataset

ARM = get_task("arm")
SOURCE = variants_of(ARM.name)["vanilla"].source
SPACE = SOURCE.space
PLANTED = np.array([1.6, 1.2, 3.0, 2.0])  # not the task's own truth
PROBLEM = Problem(ARM, SOURCE)


def waving_policy(seed=3):
    """A random network: it waves the arm about without turning it over at once."""
    rng = np.random.default_rng(seed)
    shapes = ((16, 4), (16, 16), (2, 16))
    layers = tuple(
        (rng.normal(0, 0.5, shape).astype(np.float32), np.zeros(shape[0], np.float32))
        for shape in shapes
    )
    return Policy(layers, "tanh", ARM.action_low, ARM.action_high)


def recorded(dynamics, policy, episodes=1, steps=120, noise=0.0, seed=0):
    """What targets with these dynamics (episodes, d) show of the policy."""
    rng = np.random.default_rng(seed)
    simulations = Simulations(ARM, SOURCE, episodes)
    simulations.set_dynamics(np.broadcast_to(dynamics, (episodes, 4)))
    draw = (lambda: noise * rng.standard_normal((episodes, 4))) if noise else None
    found = run_episodes(ARM, simulations, policy.act, ARM.initial(episodes, rng), steps, draw)
    parts = []
    for row in range(episodes):
        n = int(found.lengths[row])
        seen = found.observations[row, : n + 1]
        parts.append(
            TransitionDataset(
                seen[:-1],
                found.actions[row, :n],
                seen[1:],
                np.zeros(n),
                0.02,
                ARM.columns,
                "planted",
            )
        )
    return TransitionDataset.concatenate(parts)


def distance(mean):
    """Root mean square over the parameters, in [0, 4] coordinates; the prior's is .91."""
    return np.sqrt(np.mean((SPACE.normalise(mean) - SPACE.normalise(PLANTED)) ** 2))


class TestUdr:
    def test_bounds_are_ordered_inside_the_search_box_and_repeat(self):
        settings = UdrSettings(policies=50)
        boxes = random_bounds(SPACE, settings, stream("a"))
        assert len(boxes) == 50
        for box in boxes:
            assert isinstance(box, Uniform)
            assert np.all(box.low >= SPACE.low)
            assert np.all(box.high <= SPACE.high)
        again = random_bounds(SPACE, settings, stream("a"))
        assert [b.to_json() for b in boxes] == [b.to_json() for b in again]


class TestDropo:
    def test_the_likelihood_is_scipys(self):
        rng = np.random.default_rng(0)
        predictions, targets = rng.normal(size=(20, 7, 3)), rng.normal(size=(7, 3))
        expected = sum(
            stats.multivariate_normal.logpdf(
                targets[w],
                predictions[:, w].mean(axis=0),
                np.cov(predictions[:, w].T) + 1e-3 * np.eye(3),
            )
            for w in range(7)
        )
        assert log_likelihood(predictions, targets, 1e-3) == pytest.approx(expected, rel=1e-10)

    def test_the_search_space_spans_means_and_log_deviations(self):
        lowest = decode(SPACE, np.zeros(8))
        highest = decode(SPACE, np.full(8, 4.0))
        np.testing.assert_allclose(lowest.mean, SPACE.low)
        np.testing.assert_allclose(lowest.std, 1e-5)
        np.testing.assert_allclose(highest.mean, SPACE.high)
        np.testing.assert_allclose(highest.std, (SPACE.high - SPACE.low) / 4)

    @pytest.mark.parametrize(
        ("noise", "epsilon", "tolerance"), [(0.0, 1e-6, 0.03), (0.003, 2e-5, 0.1)]
    )
    def test_a_planted_truth_is_recovered(self, noise, epsilon, tolerance):
        """Tolerances: three times the worst of seeds 0 to 4, .010 and .030."""
        data = recorded(PLANTED, waving_policy(), noise=noise)
        settings = DropoSettings(budget=1200, samples_per_parameter=4, epsilon=epsilon)
        estimate = Dropo(settings).fit(PROBLEM, data, stream("dropo"), silent)
        assert distance(estimate.distribution.mean) < tolerance

    def test_a_planted_spread_is_recovered(self):
        """Each episode under its own forearm mass: its deviation is found within a half."""
        spread = TruncatedGaussian(SPACE, PLANTED, np.array([1e-4, 0.5, 1e-4, 1e-4]))
        dynamics = spread.sample(16, np.random.default_rng(0)).values
        data = recorded(dynamics, waving_policy(), episodes=16, steps=12)
        settings = DropoSettings(budget=900, samples_per_parameter=5, epsilon=1e-6)
        found = Dropo(settings).fit(PROBLEM, data, stream("spread"), silent).distribution
        planted_std = float(np.std(dynamics[:, 1]))
        assert found.std[1] == pytest.approx(planted_std, rel=0.5)
        assert found.mean[1] == pytest.approx(PLANTED[1], rel=0.2)
        assert found.std[0] < 0.25

    def test_the_estimate_reports_what_it_cost(self):
        data = recorded(PLANTED, waving_policy())
        settings = DropoSettings(budget=30, samples_per_parameter=2, epsilon=1e-4)
        estimate = Dropo(settings).fit(PROBLEM, data, stream("cost"), silent)
        evaluations = estimate.diagnostics["evaluations"]
        assert 30 <= evaluations < 30 + 20  # whole generations
        assert estimate.simulated_steps == evaluations * 8 * len(data)

    def test_windows_longer_than_the_recording_are_refused(self):
        data = recorded(PLANTED, waving_policy(), steps=20)
        with pytest.raises(InvalidInput, match="21 consecutive transitions"):
            Dropo(DropoSettings(steps=21)).fit(PROBLEM, data, stream("long"), silent)

    def test_the_global_generator_decides_nothing(self):
        data = recorded(PLANTED, waving_policy(), steps=20)
        settings = DropoSettings(budget=40, samples_per_parameter=2)
        found = []
        for seed in (1, 2):
            np.random.seed(seed)  # noqa: NPY002
            found.append(Dropo(settings).fit(PROBLEM, data, stream("same"), silent))
        assert found[0].distribution.to_json() == found[1].distribution.to_json()


class TestReps:
    settings = SimOptSettings()

    def test_the_step_respects_the_trust_region(self):
        """The weights' divergence from uniform is the threshold, where the dual binds."""
        rng = np.random.default_rng(0)
        samples = rng.normal(size=(20_000, 3))
        costs = np.sum((samples - 3) ** 2, axis=1)
        mean, covariance, temperature = reps(samples, costs, np.eye(3), self.settings)
        scaled = (costs - costs.min()) / (np.percentile(costs, 90) - costs.min())
        weights = np.exp(-scaled / temperature)
        weights /= weights.sum()
        divergence = np.sum(weights * np.log(weights * len(weights)))
        assert divergence == pytest.approx(self.settings.kl_threshold, rel=0.01)
        assert np.all(mean > 0.5)
        np.testing.assert_allclose(covariance / covariance[0, 0], np.eye(3))

    def test_repeated_steps_find_the_minimum_of_a_quadratic(self):
        """facts of the literature: after 25 updates in 4-D the error is below a thousandth."""
        rng = np.random.default_rng(0)
        optimum, mean, covariance = np.array([1.0, 3.0, 2.5, 0.5]), np.full(4, 2.0), np.eye(4)
        for _ in range(25):
            samples = rng.multivariate_normal(mean, covariance, 1000)
            costs = np.sum((samples - optimum) ** 2, axis=1)
            mean, covariance, _ = reps(samples, costs, covariance, self.settings)
        assert np.sqrt(np.mean((mean - optimum) ** 2)) < 1e-3
        assert np.all(np.sqrt(np.diag(covariance)) < 0.02)

    def test_one_sample_with_all_the_weight_leaves_a_covariance(self):
        samples = np.random.default_rng(0).normal(size=(10, 3))
        costs = np.array([0.0] + [1e9] * 9)
        _, covariance, _ = reps(samples, costs, np.eye(3), self.settings)
        assert np.all(np.linalg.eigvalsh(covariance) > 0)

    def test_an_outlier_does_not_decide_the_temperature(self):
        rng = np.random.default_rng(0)
        samples = rng.normal(size=(1000, 3))
        costs = np.sum((samples - 3) ** 2, axis=1)
        usual, _, _ = reps(samples, costs, np.eye(3), self.settings)
        worst = np.argmax(costs)
        costs[worst] = 1e6
        unusual, _, _ = reps(samples, costs, np.eye(3), self.settings)
        np.testing.assert_allclose(unusual, usual, rtol=0.05)

    def test_equal_costs_move_nothing_but_by_chance(self):
        samples = np.random.default_rng(0).normal(size=(50_000, 2))
        mean, covariance, _ = reps(samples, np.ones(50_000), np.eye(2), self.settings)
        np.testing.assert_allclose(mean, 0, atol=4 / np.sqrt(50_000))
        np.testing.assert_allclose(covariance, np.eye(2), atol=0.02)


class TestSimOpt:
    def test_it_moves_towards_a_planted_truth_and_grows_surer(self):
        """By 85 % with this policy. Not with any: seeds 1 to 3 give 67, 22 and 39 %, and with 4
        and 5 it ends 15 % farther away, in a poor fit of trajectories that tell little."""
        policy = waving_policy(seed=0)
        evidence = Evidence(policy, recorded(PLANTED, policy))
        method = SimOpt(SimOptSettings(updates=25, samples=400))
        start = method.start(PROBLEM)
        update = method.tell(PROBLEM, start, evidence, stream("simopt"), silent)
        before, after = method.ask(PROBLEM, start), method.ask(PROBLEM, update.state)
        assert distance(after.mean) < 0.25 * distance(before.mean)
        assert np.all(after.std < 0.1 * before.std)
        assert update.simulated_steps == 25 * 400 * len(evidence.data)

    def test_the_prior_is_the_papers(self):
        method = SimOpt(SimOptSettings())
        assert (
            method.ask(PROBLEM, method.start(PROBLEM)).to_json() == Gaussian.prior(SPACE).to_json()
        )


def test_a_method_is_not_given_the_truth():
    """Neither the problem nor its parts lead to the hidden values (nor may methods import them)."""
    assert not hasattr(PROBLEM.task, "variants")
    assert "hidden" not in vars(PROBLEM.source)
    assert not hasattr(SPACE.parameters[0], "nominal")
