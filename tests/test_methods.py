"""Formulas against references, and planted truths recovered."""

import dataclasses

import numpy as np
import pytest
import torch
from scipy import stats

from adr_service.distributions import Gaussian, TruncatedGaussian, Uniform
from adr_service.errors import InvalidInput
from adr_service.methods import bayrn
from adr_service.methods.base import Evidence, Problem
from adr_service.methods.droid import Droid, DroidSettings
from adr_service.methods.dropo import Dropo, DropoSettings, decode, log_likelihood
from adr_service.methods.simopt import SimOpt, SimOpt1Settings, SimOptSettings, reps
from adr_service.methods.sysid import Sysid, SysidSettings
from adr_service.methods.udr import UdrSettings, random_bounds
from adr_service.progress import silent
from adr_service.randomness import stream
from adr_service.simulation.batch import Simulations
from adr_service.simulation.rollout import run_episodes
from adr_service.target import simulate_rollout
from adr_service.tasks.catalogue import get_task, variants_of
from adr_service.training.policy import Policy
from adr_service.transitions import TransitionDataset
from tests.recordings import recording

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

    @pytest.mark.parametrize("exact", [True, False])
    def test_the_estimate_reports_what_it_cost(self, exact):
        data = recorded(PLANTED, waving_policy())
        settings = DropoSettings(budget=30, samples_per_parameter=2, epsilon=1e-4, exact=exact)
        estimate = Dropo(settings).fit(PROBLEM, data, stream("cost"), silent)
        evaluations = estimate.diagnostics["evaluations"]
        assert 30 <= evaluations < 30 + 20  # whole generations
        draws = 8 * evaluations  # those of each candidate
        if not exact:
            draws = sum(fitted["draws"] for fitted in estimate.diagnostics["emulators"])
        draws += 8 * estimate.diagnostics["searches"]  # and those of the judgement
        assert estimate.simulated_steps == draws * len(data)

    def test_the_emulated_search_finds_as_good_an_optimum_as_the_exact_one(self):
        """By the exact loss; better by up to 0.1 nat per window with 2 of 3 seeds, never worse by
        more than 0.02, since both searches end a little short of the optimum."""
        data = recorded(PLANTED, waving_policy(), steps=60, noise=0.003)
        losses = {}
        for exact in (True, False):
            settings = DropoSettings(budget=800, samples_per_parameter=3, epsilon=2e-5, exact=exact)
            found = Dropo(settings).fit(PROBLEM, data, stream("exact"), silent).diagnostics
            losses[exact] = found["loss_per_window"]
            assert found["searched_loss_per_window"] == pytest.approx(losses[exact], abs=0.01)
        assert losses[False] < losses[True] + 0.05

    def test_the_published_hopper_masses_are_recovered(self, hopper_clean):
        """From 200 transitions; with 500 and a budget of 2000 it was .01 %."""
        task = get_task("hopper")
        variant = variants_of("hopper")["vanilla"]
        settings = DropoSettings(budget=1500, epsilon=1e-5)
        problem, data = Problem(task, variant.source), hopper_clean.first(200)
        estimate = Dropo(settings).fit(problem, data, stream("published"), silent)
        np.testing.assert_allclose(estimate.distribution.mean, variant.truth, rtol=0.02)

    def test_several_epsilons_are_several_searches(self):
        several = DropoSettings(epsilon=[1e-5, 1e-3])
        assert [settings.epsilon for settings in several.each()] == [1e-5, 1e-3]
        with pytest.raises(InvalidInput, match="one epsilon"):
            Dropo(several)

    def test_windows_longer_than_the_recording_are_refused(self):
        data = recorded(PLANTED, waving_policy(), steps=20)
        with pytest.raises(InvalidInput, match="21 consecutive transitions"):
            Dropo(DropoSettings(steps=21, epsilon=1e-4)).fit(PROBLEM, data, stream("long"), silent)

    def test_the_global_generator_decides_nothing(self):
        data = recorded(PLANTED, waving_policy(), steps=20)
        settings = DropoSettings(budget=40, samples_per_parameter=2, epsilon=1e-4)
        found = []
        for seed in (1, 2):
            np.random.seed(seed)  # noqa: NPY002
            found.append(Dropo(settings).fit(PROBLEM, data, stream("same"), silent))
        assert found[0].distribution.to_json() == found[1].distribution.to_json()


class TestBayRn:
    one = SPACE.subset(("fore_mass",))

    def test_every_point_of_the_cube_is_a_valid_distribution_and_has_one_name(self):
        for point in np.random.default_rng(0).random((200, 8)):
            box = bayrn.decode(SPACE, point)
            assert np.all(SPACE.low <= box.low)
            assert np.all(box.high <= SPACE.high)
            np.testing.assert_allclose(bayrn.encode(box), point, atol=1e-9)
        whole = bayrn.decode(SPACE, np.ones(8))
        np.testing.assert_allclose([whole.low, whole.high], [SPACE.low, SPACE.high])
        assert np.all(np.isfinite(bayrn.encode(whole)))

    @pytest.mark.parametrize("seed", [0, pytest.param(1, marks=pytest.mark.slow)])
    def test_it_finds_the_optimum_of_a_known_return_surface(self, seed):
        """Best at mean 1.5 kg and width 0.5 kg; within 2 % of the range of returns, seeds 0 to 4:
        the worst regret after ten proposals was found below .01."""

        def earned(box):
            return 100 - 10 * (box.mean[0] - 1.5) ** 2 - 5 * (box.high[0] - box.low[0] - 0.5) ** 2

        boxes = random_bounds(self.one, UdrSettings(policies=5), stream("bayrn", seed))
        returns = [earned(box) for box in boxes]
        rng = stream("propose", seed)
        for _ in range(10):
            proposal = bayrn.propose(boxes, np.array(returns), rng)
            boxes.append(proposal.next)
            returns.append(earned(proposal.next))
        final = bayrn.propose(boxes, np.array(returns), rng)
        assert returns[final.best] > 100 - 2.0
        assert returns[final.best] > max(returns[:5])

    def test_the_same_stream_proposes_the_same_and_torchs_own_goes_on(self):
        boxes = random_bounds(SPACE, UdrSettings(policies=4), stream("a"))
        torch.manual_seed(3)
        before = torch.rand(1)
        torch.manual_seed(3)
        first = bayrn.propose(boxes, np.arange(4.0), stream("same"))
        assert torch.rand(1) == before
        again = bayrn.propose(boxes, np.arange(4.0), stream("same"))
        assert first.next.to_json() == again.next.to_json()


class TestDroid:
    @pytest.mark.parametrize(("noise", "tolerance"), [(0.0, 0.003), (0.003, 0.03)])
    def test_a_planted_truth_is_recovered(self, noise, tolerance):
        """Tolerances: three times the worst of seeds 0 to 2, .001 (rounded up) and .008."""
        data = recorded(PLANTED, waving_policy(), noise=noise)
        estimate = Droid(DroidSettings(budget=600)).fit(PROBLEM, data, stream("droid"), silent)
        assert distance(estimate.distribution.mean) < tolerance
        assert estimate.simulated_steps == estimate.diagnostics["evaluations"] * len(data)

    def test_the_distribution_is_the_searchs_own_and_narrows(self):
        data = recorded(PLANTED, waving_policy())
        early, late = (
            Droid(DroidSettings(budget=budget)).fit(PROBLEM, data, stream("n"), silent)
            for budget in (80, 600)
        )
        assert isinstance(early.distribution, Gaussian)
        assert np.all(late.distribution.std < 0.1 * early.distribution.std)


class TestSysid:
    @pytest.mark.parametrize(("noise", "tolerance"), [(0.0, 1e-6), (0.003, 0.04)])
    def test_a_planted_truth_is_recovered(self, noise, tolerance):
        """Tolerances: rounding, and three times the worst of seeds 0 to 2, .0124."""
        data = recorded(PLANTED, waving_policy(), noise=noise)
        estimate = Sysid(SysidSettings()).fit(PROBLEM, data, stream("sysid"), silent)
        assert distance(estimate.distribution.mean) < tolerance
        assert np.all(estimate.distribution.std == 0)

    def test_its_standard_deviations_are_those_of_repeated_recordings(self):
        """Root mean square over 12 recordings, which errs by a fifth; noise on outputs."""
        errors, said = [], []
        for seed in range(12):
            clean = recorded(PLANTED, waving_policy(), seed=seed)
            noise = 0.003 * np.random.default_rng(seed).standard_normal((len(clean), 4))
            data = dataclasses.replace(clean, next_observations=clean.next_observations + noise)
            estimate = Sysid(SysidSettings(starts=1)).fit(PROBLEM, data, stream("s"), silent)
            errors.append(estimate.distribution.mean - PLANTED)
            said.append(estimate.diagnostics["std"])
        ratio = np.sqrt(np.mean(np.square(errors), axis=0) / np.mean(np.square(said), axis=0))
        assert np.all((ratio > 0.5) & (ratio < 2))

    def test_hoppers_masses_are_recovered(self):
        hopper, hidden = get_task("hopper"), variants_of("hopper")["vanilla"].hidden
        data = recording("hopper", 60)
        estimate = Sysid(SysidSettings(starts=2)).fit(
            Problem(hopper, hidden.source), data, stream("h"), silent
        )
        np.testing.assert_allclose(estimate.distribution.mean, hidden.values, rtol=1e-5)


class TestOnHopper:
    """On DROPO's published recordings; the noisy one has noise on next observations alone."""

    task, variant = get_task("hopper"), variants_of("hopper")["vanilla"]

    def distance(self, method, data, seed=0):
        """Root mean square over the masses, in [0, 4] coordinates; the prior's is .70."""
        problem = Problem(self.task, self.variant.source)
        mean = method.fit(problem, data, stream("hopper", seed), silent).distribution.mean
        space = self.variant.source.space
        miss = space.normalise(mean) - space.normalise(self.variant.truth)
        return np.sqrt(np.mean(miss**2))

    @pytest.mark.parametrize("recording", ["hopper_clean", "hopper_noisy"])
    @pytest.mark.parametrize("episode", [0, pytest.param(1, marks=pytest.mark.slow)])
    def test_droid_recovers_the_masses_from_a_hundred_transitions(
        self, request, recording, episode
    ):
        """Tolerance: three times the worst of four episodes, .0018; with 200 transitions, open
        loop diverges, and the worst was .06."""
        data = request.getfixturevalue(recording).split()[episode].first(100)
        assert self.distance(Droid(DroidSettings(budget=600)), data) < 0.006

    def test_dropo_recovers_the_masses_from_noisy_transitions(self, hopper_noisy):
        """Tolerance: three times what was found with 200 transitions, .0064."""
        settings = DropoSettings(budget=1500, epsilon=1e-5)
        assert self.distance(Dropo(settings), hopper_noisy.first(200)) < 0.02

    def test_sysid_recovers_the_masses_from_noisy_transitions(self, hopper_noisy):
        """Tolerance: three times what was found with 200 transitions, .0060."""
        assert self.distance(Sysid(SysidSettings(starts=2)), hopper_noisy.first(200)) < 0.02


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

    def test_noise_on_the_recording_changes_little(self):
        """Found: .135 where it is .133 without noise, of the prior's .91; tolerance, a quarter."""
        policy = waving_policy(seed=0)
        evidence = Evidence(policy, recorded(PLANTED, policy, noise=0.003))
        method = SimOpt(SimOptSettings(updates=25, samples=400))
        update = method.tell(PROBLEM, method.start(PROBLEM), evidence, stream("simopt"), silent)
        assert distance(method.ask(PROBLEM, update.state).mean) < 0.25 * 0.91

    @pytest.mark.slow
    @pytest.mark.parametrize("variant", ["vanilla", "noisy"])
    def test_hoppers_masses_come_nearer(self, variant):
        """From .70 to .22 without noise and .41 with it, with a linear policy that leaps and falls
        after 75 steps; tolerance, half a coordinate. Policies that stand still tell less."""
        hopper, pair = get_task("hopper"), variants_of("hopper")[variant]
        rng = np.random.default_rng(132)
        scale = np.array([1, 1, 1, 1, 1, 0.3, 0.3, 0.2, 0.1, 0.1, 0.1])
        weight = (rng.normal(0, 1.0, (3, 11)) * scale).astype(np.float32)
        bias = rng.normal(0, 0.5, 3).astype(np.float32) - 1.25 * weight[:, 0]
        layers = ((weight, bias.astype(np.float32)),)
        policy = Policy(layers, "tanh", hopper.action_low, hopper.action_high)
        data = simulate_rollout(hopper, variant, policy.act, 200, np.random.default_rng(0))
        problem, method = Problem(hopper, pair.source), SimOpt(SimOpt1Settings(samples=1000))
        update = method.tell(
            problem, method.start(problem), Evidence(policy, data), stream("x"), silent
        )
        space, mean = pair.source.space, method.ask(problem, update.state).mean
        miss = space.normalise(mean) - space.normalise(pair.truth)
        assert np.sqrt(np.mean(miss**2)) < 0.5

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
