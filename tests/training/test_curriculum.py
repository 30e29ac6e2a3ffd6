"""Curricula during trainings: which episodes move them, and what is kept of it."""

import numpy as np
import pytest

from adr_service.distributions import Draws, Uniform
from adr_service.errors import InvalidInput
from adr_service.randomness import stream
from adr_service.simulation.vec_env import RandomizedVecEnv
from adr_service.tasks.catalogue import get_task, source_of
from adr_service.training.curriculum import Course
from adr_service.training.train import train
from tests.training.examples import settings

ARM, SOURCE = get_task("arm"), source_of("arm", "vanilla")
SPACE = SOURCE.space
BOX = Uniform(SPACE, SPACE.low, SPACE.high)


class Walk:
    """A curriculum that moves its point on, and keeps what moved it."""

    def __init__(self, episodes):
        self.episodes, self.moves = episodes, []

    @property
    def distribution(self):
        share = 0.1 + 0.01 * len(self.moves)
        return Uniform.point(SPACE, SPACE.low + share * (SPACE.high - SPACE.low))

    def points(self, n):
        return np.tile(self.distribution.mean, (n, 1))

    def sample(self, n, rng):
        return self.distribution.sample(n, rng)

    def move(self, dynamics, returns):
        np.testing.assert_array_equal(dynamics, self.points(len(returns)))
        self.moves.append(returns)


def test_a_curriculum_moves_after_each_environments_share_of_episodes():
    walk = Walk(episodes=5)
    course = Course(walk, SPACE, environments=3)  # two episodes of each

    def end(rows, returns, steps):
        course.ended(np.array(rows), walk.points(len(rows)), np.array(returns), steps)

    end([0, 1], [1.0, 2.0], 10)
    end([0], [3.0], 20)
    end([0], [99.0], 30)  # beyond its share
    end([1, 2], [4.0, 5.0], 40)
    assert walk.moves == []
    end([2], [6.0], 50)
    assert walk.moves[0].tolist() == [1.0, 2.0, 3.0, 4.0, 5.0, 6.0]
    assert [(phase.steps, phase.mean_return) for phase in course.phases] == [(0, 3.5), (50, None)]


def test_episodes_from_before_a_move_do_not_count_for_the_next():
    walk = Walk(episodes=2)
    course = Course(walk, SPACE, environments=2)

    def end(rows, returns):
        course.ended(np.array(rows), walk.points(len(rows)), np.array(returns), 0)

    end([0], [1.0])
    end([1], [2.0])  # moves; environment 0 is in the midst of an older episode, 1 begins anew
    end([0], [99.0])
    end([1], [3.0])
    end([0], [4.0])
    assert [returns.tolist() for returns in walk.moves] == [[1.0, 2.0], [3.0, 4.0]]


def test_short_episodes_count_no_more_than_long_ones():
    """Half of all episodes fail in their first step; more than half of those that end soon."""

    class Stay(Walk):
        def move(self, dynamics, returns):
            self.moves.append(np.mean(returns))

    rng, stay, n = np.random.default_rng(0), Stay(episodes=8), 8
    course = Course(stay, SPACE, environments=n)
    lengths, done = np.where(rng.random(n) < 0.5, 1, 50), np.zeros(n, np.int64)
    begun, soon = np.zeros(n, np.int64), []  # those that begin and end in one window of 60 steps
    for step in range(20_000):
        done += 1
        rows = np.flatnonzero(done == lengths)
        if len(rows):
            earned = (lengths[rows] == 50).astype(float)
            soon += earned[begun[rows] // 60 == step // 60].tolist()
            course.ended(rows, stay.points(len(rows)), earned, n * step)
            lengths[rows], done[rows] = np.where(rng.random(len(rows)) < 0.5, 1, 50), 0
            begun[rows] = step + 1
    error = np.std(stay.moves) / np.sqrt(len(stay.moves))
    assert np.mean(stay.moves) == pytest.approx(0.5, abs=4 * error)
    assert error < 0.02
    assert np.mean(soon) < 0.4


def test_the_environment_reports_the_dynamics_and_the_return_of_episodes_that_end():
    heard, rewards = [], np.zeros(4)
    env = RandomizedVecEnv(
        ARM, SOURCE, BOX, 4, np.random.default_rng(0), ended=lambda *event: heard.append(event)
    )
    env.reset()
    for step in range(1, 200):
        before = env.dynamics
        _, earned, done, _ = env.step(np.ones((4, 2)))
        rewards += earned
        if done.any():
            rows, dynamics, returns, steps = heard[-1]
            np.testing.assert_array_equal(rows, np.flatnonzero(done))
            np.testing.assert_array_equal(dynamics, before[done])
            np.testing.assert_allclose(returns, rewards[done], rtol=1e-6)
            assert steps == 4 * step
            rewards[done] = 0.0
    assert len(heard) > 3


@pytest.mark.parametrize("algorithm", ["ppo", pytest.param("sac", marks=pytest.mark.slow)])
def test_a_training_draws_from_its_curriculum_and_is_judged_on_the_distribution(algorithm):
    given = settings(algorithm, max_steps=5760, evaluate_every=2880, stop_at_threshold=False)
    walk = Walk(episodes=12)
    moved = train(ARM, SOURCE, BOX, given, stream("one"), curriculum=walk)
    assert len(moved.phases) == len(walk.moves) + 1 > 2
    steps = [phase.steps for phase in moved.phases]
    assert steps == sorted(set(steps))
    assert moved.phases[-1].distribution == walk.distribution.to_json()
    assert [phase.mean_return for phase in moved.phases[:-1]] == pytest.approx(
        [returns.mean() for returns in walk.moves]
    )
    middle = Uniform.point(BOX.space, BOX.mean)
    elsewhere = train(ARM, SOURCE, middle, given, stream("one"), curriculum=Walk(episodes=12))
    # it has trained on the same, and learned the same of it
    assert elsewhere.phases == moved.phases
    np.testing.assert_equal(elsewhere.networks, moved.networks)
    assert elsewhere.curve != moved.curve


@pytest.mark.parametrize("episodes", [0, -5])
def test_a_curriculum_that_would_move_after_no_episode_is_refused_at_the_start(episodes):
    with pytest.raises(InvalidInput, match=f"needs 1 episode or more for a move; given {episodes}"):
        Course(Walk(episodes), SPACE, environments=3)


def test_a_curriculum_may_draw_the_smallest_feasible_values_and_none_below():
    class Draw(Walk):
        values = np.tile(SPACE.feasible_low, (2, 1))

        def sample(self, n, rng):
            return Draws(self.values, 0)

    draw, rng = Draw(episodes=2), np.random.default_rng(0)
    course = Course(draw, SPACE, environments=2)
    assert course.sample(2, rng).values is draw.values
    for wrong in (SPACE.feasible_low[1] - 0.01, np.nan, np.inf):
        draw.values = np.tile(SPACE.feasible_low, (2, 1))
        draw.values[1, 1] = wrong
        with pytest.raises(InvalidInput, match=f"must be finite and at least .*{wrong}"):
            course.sample(2, rng)
    with pytest.raises(InvalidInput, match=r"must have the shape \(5, 4\); given \(2, 4\)"):
        course.sample(5, rng)


def test_a_curriculum_whose_distribution_leaves_the_space_is_refused_when_it_does():
    class Narrow(Walk):
        @property
        def distribution(self):
            space = SPACE.subset(SPACE.names[: len(SPACE) - len(self.moves)])
            return Uniform(space, space.low, space.high)

        def move(self, dynamics, returns):
            self.moves.append(returns)

    course = Course(Narrow(episodes=1), SPACE, environments=1)
    with pytest.raises(InvalidInput, match=r"the curriculum's distribution is over .*_friction; "):
        course.ended(np.array([0]), SPACE.low[None], np.array([1.0]), 10)
