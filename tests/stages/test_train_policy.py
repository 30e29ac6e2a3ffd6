"""Trainings as stages: their curve, their checkpoints, and the price of their settings."""

from dataclasses import replace

import numpy as np
import pytest
import safetensors.numpy

from adr_service.programs.references import prior_training
from adr_service.specs import RunSpec
from adr_service.stages.base import events_of
from tests.stages.examples import Speed, training

TINY = {
    "backend": "sb3",
    "max_steps": 480,
    "hidden": [16, 16],
    "batch_size": 32,
    "evaluate_every": 240,
    "evaluation_episodes": 4,
}
STAGE = training(**TINY)


@pytest.fixture(scope="module")
def trained():
    """The result of `STAGE`, and its checkpoints in order."""
    checkpoints = []

    def progress(fraction, checkpoint=None, **facts):
        if checkpoint is not None:
            checkpoints.append(checkpoint)

    return run(STAGE, progress), checkpoints


def run(stage, progress=lambda fraction, **facts: None):
    return stage.compute(np.random.default_rng(0), progress)


class TestResult:
    def test_its_events_are_its_learning_curve(self, trained):
        result, _ = trained
        *points, finished = events_of(STAGE, result)
        assert [point.steps for point in points] == [240, 480]
        assert [point.mean_return for point in points] == [p.mean_return for p in result.curve]
        assert {point.digest for point in points} == {finished.digest} == {STAGE.digest}

    def test_it_is_the_policy_of_the_best_evaluation(self, trained):
        result, checkpoints = trained
        best = max(result.curve, key=lambda point: point.mean_return)
        assert result.source_return == best.mean_return
        (at_best,) = [c for c in checkpoints if c.steps == best.steps]
        assert result.policy == at_best.content

    def test_every_checkpoint_has_the_curve_so_far(self, trained):
        result, checkpoints = trained
        events = STAGE.events(result)
        assert [len(c.events) for c in checkpoints] == [1, 2]
        for checkpoint in checkpoints:
            assert list(checkpoint.events) == events[: len(checkpoint.events)]
            assert checkpoint.steps == checkpoint.events[-1].steps

    def test_the_last_checkpoint_has_the_best_policy(self, trained):
        result, checkpoints = trained
        assert checkpoints[-1].content == result.policy


def test_a_threshold_that_no_evaluation_reached_is_reported(trained):
    result, _ = trained
    assert not result.reached_threshold
    assert result.steps == TINY["max_steps"]


class TestCost:
    def seconds(self, rate=1000.0, **changes):
        return training(**{**TINY, **changes}).cost(Speed(rate)).seconds

    @pytest.mark.parametrize(
        "changes",
        [
            {"max_steps": 960},
            {"gradient_steps": 2},
            {"hidden": [32, 32]},
            {"hidden": [16, 16, 16]},
            {"batch_size": 64},
            {"evaluation_episodes": 8},
            {"evaluate_every": 120},
        ],
        ids=str,
    )
    def test_more_work_takes_longer(self, changes):
        assert self.seconds(**changes) > self.seconds()

    def test_more_environments_need_fewer_updates(self):
        assert self.seconds(environments=24) < self.seconds(environments=12)

    def test_twice_the_steps_and_half_the_evaluations_of_each_take_twice_as_long(self):
        once = self.seconds(max_steps=4800, evaluate_every=2400)
        assert self.seconds(max_steps=9600, evaluate_every=2400) == pytest.approx(2 * once)

    def test_a_faster_core_simulates_faster_and_updates_as_before(self):
        """Between two cores the seconds differ by the simulated steps alone."""
        task_horizon, evaluations = 200, 2
        simulated = 480 + evaluations * 4 * task_horizon
        saved = self.seconds(rate=1e3) - self.seconds(rate=1e4)
        assert saved == pytest.approx(simulated * (1e-3 - 1e-4))

    def test_the_faster_library_costs_less(self):
        assert self.seconds(backend="sbx") < self.seconds(backend="sb3")

    def test_it_says_how_many_steps_and_bytes_it_takes(self, trained):
        cost = STAGE.cost(Speed())
        assert cost.environment_steps == 480
        assert cost.target_transitions == 0
        weights = 5 * 16 + 17 * 16 + 17 * 2
        assert cost.policy_bytes == 4 * weights
        assert cost.policy_bytes < len(trained[0].policy)


def test_stand_ins_of_two_trainings_differ():
    other = replace(STAGE, seed=1)
    assert STAGE.stand_in().policy != other.stand_in().policy
    assert STAGE.stand_in().curve == []


class TestAlgorithms:
    def cost(self, task="arm", **changes):
        given = {"task": task, "method": "prior", "preset": "fast", "training": changes}
        spec = RunSpec.model_validate(given)
        return prior_training(spec).cost(Speed(1e9))

    @pytest.mark.parametrize(
        ("algorithm", "changes"),
        [
            ("crossq", {"critic_hidden": [512, 512]}),
            ("crossq", {"critic_hidden": [128, 128, 128]}),
            ("crossq", {"gradient_steps": 2}),
            ("crossq", {"confirmation_episodes": 500}),
            ("ppo", {"epochs": 20}),
            ("ppo", {"hidden": [256, 256]}),
            ("ppo", {"hidden": [128, 128, 128]}),
            ("ppo", {"confirmation_episodes": 500}),
        ],
        ids=str,
    )
    def test_more_work_takes_longer(self, algorithm, changes):
        once, more = self.cost(algorithm=algorithm), self.cost(algorithm=algorithm, **changes)
        assert more.seconds > once.seconds

    @pytest.mark.parametrize("algorithm", ["sac", "crossq", "ppo"])
    def test_updates_take_longer_where_more_is_observed(self, algorithm):
        """Here simulations take no time."""
        same = {"algorithm": algorithm, "max_steps": 100_000, "evaluation_episodes": 2}
        hopper, humanoid = (self.cost(task, **same).seconds for task in ("hopper", "humanoid"))
        assert humanoid > 1.5 * hopper

    def test_ppo_uses_whole_rollouts(self):
        cost = self.cost(algorithm="ppo", max_steps=10_000)
        assert cost.environment_steps == 2 * 32 * 128


def test_ppos_policy_is_reported_by_fresh_episodes():
    stage = training(
        algorithm="ppo",
        backend="sb3",
        max_steps=480,
        hidden=[16, 16],
        batch_size=32,
        environments=12,
        rollout_steps=8,
        evaluate_every=240,
        evaluation_episodes=4,
        confirmation_episodes=6,
    )
    result = run(stage)
    assert result.source_return == result.confirmation.mean_return
    assert result.confirmation not in result.curve
    assert stage.read(result.to_stored()) == result


def test_a_training_begins_at_the_networks_that_it_is_started_from():
    """It learns too slowly to leave them."""
    first = run(training(**TINY, start="previous"))
    still = training(**TINY, start="previous", learning_rate=1e-12)
    again, anew = (run(replace(still, start=start)) for start in (first.networks, None))
    left, kept, other = (
        safetensors.numpy.load(each.networks)["actor.mu.weight"] for each in (first, again, anew)
    )
    np.testing.assert_allclose(kept, left, atol=1e-6)
    assert np.abs(other - left).max() > 1e-2
