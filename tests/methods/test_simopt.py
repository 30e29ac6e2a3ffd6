"""SimOpt's REPS step, and its updates on one trajectory."""

from dataclasses import replace

import numpy as np
import pytest
from pydantic import ValidationError
from scipy.ndimage import gaussian_filter1d

from adr_service.distributions import Gaussian
from adr_service.errors import InvalidInput
from adr_service.methods.base import Evidence
from adr_service.methods.simopt import (
    ClosedLoop,
    SimOpt,
    SimOpt1Settings,
    SimOptSettings,
    reps,
)
from adr_service.progress import silent
from adr_service.randomness import stream
from adr_service.simulation.batch import Simulations
from tests.planted import PLANTED, PROBLEM, SPACE, recorded, stuck, waving_policy


class TestReps:
    settings = SimOptSettings()

    def test_the_step_uses_the_whole_trust_region(self):
        """The divergence of the weights from uniform is the threshold, where the dual binds."""
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
        centred = samples - mean
        np.testing.assert_allclose(covariance, (weights[:, None] * centred).T @ centred)

    def test_with_damping_the_covariance_keeps_its_shape(self):
        rng = np.random.default_rng(0)
        samples = rng.normal(size=(1000, 3))
        costs = samples[:, 0] ** 2  # the others do not matter
        damped = SimOptSettings(covariance_damping=2)
        _, kept, _ = reps(samples, costs, np.eye(3), damped)
        np.testing.assert_allclose(kept / kept[0, 0], np.eye(3))
        _, free, _ = reps(samples, costs, np.eye(3), self.settings)
        assert free[0, 0] < 0.5 * min(free[1, 1], free[2, 2])

    @pytest.mark.parametrize("damping", [0, 2])
    def test_repeated_steps_find_the_minimum_of_a_quadratic(self, damping):
        """After 25 updates in four dimensions the error is below a thousandth."""
        rng = np.random.default_rng(0)
        optimum, mean, covariance = np.array([1.0, 3.0, 2.5, 0.5]), np.full(4, 2.0), np.eye(4)
        for _ in range(25):
            samples = rng.multivariate_normal(mean, covariance, 1000)
            costs = np.sum((samples - optimum) ** 2, axis=1)
            settings = SimOptSettings(covariance_damping=damping)
            mean, covariance, _ = reps(samples, costs, covariance, settings)
        assert np.sqrt(np.mean((mean - optimum) ** 2)) < 1e-3
        assert np.all(np.sqrt(np.diag(covariance)) < 0.02)

    def test_parameters_without_influence_leave_the_covariance_regular(self):
        """Their variance stays, while that of the others shrinks to a fifth per update."""
        rng = np.random.default_rng(0)
        axes = np.linalg.qr(rng.normal(size=(4, 4)))[0]
        belief = Gaussian.prior(SPACE)
        for _ in range(40):
            samples = SPACE.normalise(belief.sample(1000, rng).values)
            costs = np.sum(((samples - 2.5) @ axes[:, :2]) ** 2, axis=1)
            mean, covariance, _ = reps(samples, costs, belief.covariance, self.settings)
            belief = Gaussian(SPACE, mean, covariance)
        np.testing.assert_allclose((mean - 2.5) @ axes[:, :2], 0, atol=1e-5)
        variances = np.linalg.eigvalsh(covariance)
        np.testing.assert_allclose(variances[:2] / variances[-1], 1e-12, rtol=1e-3)

    @pytest.mark.parametrize("damping", [0.0, 1.0])
    def test_a_distribution_that_has_become_a_point_stays_one(self, damping):
        """After many updates without noise, when all samples would be equal."""
        rng, settings = np.random.default_rng(0), SimOptSettings(covariance_damping=damping)
        belief = Gaussian.prior(SPACE)
        for _ in range(120):
            samples = SPACE.normalise(belief.sample(200, rng).values)
            costs = np.sum((samples - 2.5) ** 2, axis=1)
            mean, covariance, _ = reps(samples, costs, belief.covariance, settings)
            belief = Gaussian(SPACE, mean, covariance)
        np.testing.assert_allclose(mean, 2.5, atol=1e-6)
        assert np.all(np.linalg.eigvalsh(covariance) > 0.9e-24)

    @pytest.mark.parametrize(("scale", "shift"), [(1000.0, 0.0), (1.0, 50.0), (0.01, -3.0)])
    def test_the_unit_of_costs_does_not_matter(self, scale, shift):
        samples = np.random.default_rng(0).normal(size=(500, 3))
        costs = np.sum((samples - 3) ** 2, axis=1)
        one = reps(samples, costs, np.eye(3), self.settings)
        other = reps(samples, scale * costs + shift, np.eye(3), self.settings)
        for a, b in zip(one, other, strict=True):
            np.testing.assert_allclose(a, b, rtol=1e-4)

    def test_more_damping_keeps_more_of_the_covariance(self):
        samples = np.random.default_rng(0).normal(size=(500, 3))
        costs = np.sum((samples - 3) ** 2, axis=1)
        weak, strong = (
            reps(samples, costs, np.eye(3), SimOptSettings(covariance_damping=damping))[1][0, 0]
            for damping in (1.0, 4.0)
        )
        assert strong == pytest.approx(weak**0.25)
        assert weak < strong < 1

    @pytest.mark.parametrize(
        ("wrong", "told"),
        [
            ({"kl_threshold": 7.0}, "1000 samples diverge by their logarithm at most, 6.91 nat"),
            ({"kl_threshold": 2.4, "samples": 10}, "kl_threshold of 2.4 nat bounds nothing"),
            ({"covariance_damping": 0.5}, "give 0, or at least 1"),
        ],
    )
    def test_updates_without_a_trust_region_are_refused(self, wrong, told):
        with pytest.raises(ValidationError, match=told):
            SimOptSettings(**wrong)

    def test_one_sample_with_all_the_weight_leaves_a_covariance(self):
        samples = np.random.default_rng(0).normal(size=(10, 3))
        costs = np.array([0.0] + [1e9] * 9)
        _, covariance, _ = reps(samples, costs, np.eye(3), self.settings)
        assert np.all(np.linalg.eigvalsh(covariance) > 0)

    def test_too_few_samples_for_a_full_covariance_are_an_error(self):
        samples = np.random.default_rng(0).normal(size=(10, 12))
        costs = np.sum(samples**2, axis=1)
        with pytest.raises(InvalidInput, match="10 samples of 12 parameters have no spread"):
            reps(samples, costs, np.eye(12), self.settings)
        damped = SimOptSettings(covariance_damping=2)
        assert np.all(np.isfinite(reps(samples, costs, np.eye(12), damped)[1]))

    def test_an_outlier_does_not_decide_the_temperature(self):
        rng = np.random.default_rng(0)
        samples = rng.normal(size=(1000, 3))
        costs = np.sum((samples - 3) ** 2, axis=1)
        usual, _, _ = reps(samples, costs, np.eye(3), self.settings)
        costs[np.argmax(costs)] = 1e6
        unusual, _, _ = reps(samples, costs, np.eye(3), self.settings)
        np.testing.assert_allclose(unusual, usual, rtol=0.05)

    def test_equal_costs_move_nothing_but_by_chance(self):
        samples = np.random.default_rng(0).normal(size=(50_000, 2))
        mean, covariance, _ = reps(samples, np.ones(50_000), np.eye(2), self.settings)
        np.testing.assert_allclose(mean, 0, atol=4 / np.sqrt(50_000))
        np.testing.assert_allclose(covariance, np.eye(2), atol=0.02)


class TestUpdates:
    policy = waving_policy(seed=0)
    evidence = Evidence(policy, recorded(policy, episodes=2, steps=20, noise=0.003))

    def update(self, settings, state=None, name="simopt"):
        method = SimOpt(settings)
        state = method.start(PROBLEM) if state is None else state
        return method.tell(PROBLEM, state, self.evidence, stream(name), silent)

    def test_the_start_is_the_papers_prior(self):
        method = SimOpt(SimOptSettings())
        start = method.ask(PROBLEM, method.start(PROBLEM))
        assert start.to_json() == Gaussian.prior(SPACE).to_json()

    def test_an_earlier_visit_has_a_say_and_a_cost(self):
        settings = SimOptSettings(updates=1, samples=200)
        alone = self.update(settings)
        heavy = PLANTED + np.array([1.0, 1.0, 0.0, 0.0])
        other = Evidence(self.policy, recorded(self.policy, heavy, episodes=8, steps=20))
        remembered = replace(self.evidence, earlier=(other,))
        method = SimOpt(settings)
        start = method.start(PROBLEM)
        both = method.tell(PROBLEM, start, remembered, stream("simopt"), silent)
        assert both.simulated_steps == 200 * (len(self.evidence.data) + len(other.data))
        masses = [SPACE.denormalise(np.array(each.state["location"]))[:2] for each in (alone, both)]
        assert np.all(masses[1] > masses[0])

    def test_a_stuck_sensor_does_not_outweigh_the_others(self):
        """Its own cost is the distance of the simulated angles from it, in radians."""
        data = stuck(self.evidence.data, column=1, value=0.1)
        loop = ClosedLoop(PROBLEM, Evidence(self.policy, data), SimOptSettings(), 1)
        assert loop.costs(PLANTED[None], silent)[0] < 10

    @pytest.mark.parametrize(
        ("l1", "l2", "filter_std"), [(1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.5, 2.0, 5.0)]
    )
    def test_the_cost_is_the_papers_discrepancy(self, l1, l2, filter_std):
        """Eq. 4: weighted sums of absolute and of squared differences, filtered along time."""
        task, source = PROBLEM.task, PROBLEM.source
        settings = SimOptSettings(l1_weight=l1, l2_weight=l2, filter_std=filter_std)
        data = recorded(self.policy, episodes=1, steps=20)
        wrong = 1.3 * PLANTED[None]
        simulations = Simulations(task, source, 1)
        simulations.set_dynamics(wrong)
        simulations.set_state(task.state(data.observations[:1]))
        differences = [np.zeros(4)]
        for seen in data.next_observations:
            now = task.observe(simulations.state)
            simulations.step(self.policy.act(now))
            differences.append(task.observe(simulations.state)[0] - seen)
        known = np.concatenate([data.observations, data.next_observations[-1:]])
        weighted = np.array(differences) / known.std(axis=0)
        if filter_std:
            weighted = gaussian_filter1d(weighted, filter_std, axis=0)
        expected = l1 * np.abs(weighted).sum(axis=1).mean() + l2 * (weighted**2).sum(axis=1).mean()
        loop = ClosedLoop(PROBLEM, Evidence(self.policy, data), settings, 1)
        assert loop.costs(wrong, silent)[0] == pytest.approx(expected, rel=1e-6)

    def test_simulations_that_all_diverge_end_the_update(self):
        """The belief would narrow without any evidence."""
        absurd = self.evidence.data.observations.copy()
        absurd[:, 2:] = 1e9
        evidence = Evidence(self.policy, replace(self.evidence.data, observations=absurd))
        method = SimOpt(SimOptSettings(updates=1, samples=20))
        start = method.start(PROBLEM)
        with pytest.raises(InvalidInput, match=r"all 20 simulations of the policy .* diverged"):
            method.tell(PROBLEM, start, evidence, stream("simopt"), silent)

    def test_every_update_is_in_the_diagnostics_and_in_the_cost(self):
        update = self.update(SimOptSettings(updates=3, samples=20))
        facts = update.diagnostics["updates"]
        assert len(facts) == 3
        assert update.simulated_steps == 3 * 20 * len(self.evidence.data)
        assert all(0 <= each["clipped_draws"] <= 20 for each in facts)
        assert all(each["diverged"] == 0 for each in facts)

    def test_two_updates_are_one_after_the_other(self):
        """The second goes on from the state that the first has left."""
        together, apart = (SimOpt(SimOptSettings(updates=n, samples=20)) for n in (2, 1))
        start, rng = apart.start(PROBLEM), stream("simopt")
        once = apart.tell(PROBLEM, start, self.evidence, rng, silent)
        twice = apart.tell(PROBLEM, once.state, self.evidence, rng, silent)
        both = together.tell(PROBLEM, start, self.evidence, stream("simopt"), silent)
        assert twice.state == both.state
        facts = [*once.diagnostics["updates"], *twice.diagnostics["updates"]]
        assert facts == both.diagnostics["updates"]

    def test_a_simulation_that_diverges_is_no_better_than_the_worst(self):
        loop = ClosedLoop(PROBLEM, self.evidence, SimOptSettings(), 3)
        absurd = PLANTED * np.array([1.0, 1.0, -1e9, 1.0])  # friction that drives
        costs = loop.costs(np.array([PLANTED, absurd, 1.3 * PLANTED]), silent)
        assert loop.diverged == 1
        assert costs[1] == costs[2] > costs[0]

    @pytest.mark.parametrize(
        ("wrong", "message"),
        [
            ({"l1_weight": 0.0, "l2_weight": 0.0}, "all simulations would be alike"),
            ({"filter_std": 1e9}, "less than or equal to 1000"),
            ({"min_temperature": 1e13}, "less than or equal to 1000000"),
        ],
    )
    def test_settings_with_which_nothing_is_learned_are_refused(self, wrong, message):
        with pytest.raises(ValidationError, match=message):
            SimOptSettings(**wrong)

    def test_simopt_1_does_the_same_updates_under_another_name(self):
        one = self.update(SimOptSettings(updates=2, samples=20))
        other = self.update(SimOpt1Settings(updates=2, samples=20))
        assert other == one
