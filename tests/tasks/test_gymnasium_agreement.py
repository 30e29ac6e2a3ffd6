"""Gymnasium's own environments observe, reward and end as our tasks do, on our models.

Where the definitions differ on purpose, the tests check the difference; docs/tasks.md lists them.
"""

import gymnasium
import numpy as np
import pytest

from adr_service.simulation.batch import Simulations
from adr_service.tasks.base import State
from adr_service.tasks.catalogue import get_task, variants_of

NAMES = {
    "hopper": ("Hopper-v5", {}),
    "half_cheetah": ("HalfCheetah-v5", {}),
    "walker2d": ("Walker2d-v5", {}),
    "humanoid": ("Humanoid-v5", {"contact_cost_weight": 0.0}),
}
ALIVE = {"hopper": 1.0, "half_cheetah": 0.0, "walker2d": 1.0, "humanoid": 5.0}


def gymnasium_view(task, observations):
    """Our observations in the layout of Gymnasium's."""
    if task.name in ("hopper", "walker2d"):  # velocities clipped
        positions = observations.shape[1] // 2
        clipped = np.clip(observations[:, positions:], -10, 10)
        return np.concatenate([observations[:, :positions], clipped], axis=1)
    if task.name == "humanoid":  # without the world's rows and the root's actuation
        starts = np.cumsum([0, 45, 140, 84, 23, 84])
        kept = [
            np.arange(begin + skipped, end)
            for begin, end, skipped in zip(starts[:-1], starts[1:], (0, 10, 6, 6, 6), strict=True)
        ]
        return observations[:, np.concatenate(kept)]
    return observations


@pytest.fixture(params=NAMES)
def rollout(request, tmp_path):
    """A random episode in both: (task, ours, Gymnasium's) with rows per step."""
    task = get_task(request.param)
    name, options = NAMES[task.name]
    model = tmp_path / "model.xml"
    model.write_text(task.xml)
    env = gymnasium.make(name, xml_file=str(model), max_episode_steps=10_000, **options).unwrapped
    env.reset(seed=0)
    hidden, rng = variants_of(task.name)["vanilla"].hidden, np.random.default_rng(1)
    simulations = Simulations(task, hidden.source, 1)
    simulations.set_dynamics(hidden.values[None])
    start = task.initial(1, rng)
    simulations.set_state(start)
    env.set_state(start.qpos[0], start.qvel[0])
    ours, theirs = [], [(env._get_obs(), 0.0, False)]
    before = simulations.state
    ours.append((task.observe(before)[0], 0.0, bool(task.terminated(before)[0])))
    for _ in range(60):
        action = rng.uniform(task.action_low, task.action_high)
        observation, reward, terminated, _, _ = env.step(action)
        theirs.append((observation, reward, terminated))
        simulations.step(action)
        after = simulations.state
        ours.append(
            (
                task.observe(after)[0],
                task.reward(before, action[None], after)[0],
                bool(task.terminated(after)[0]),
            )
        )
        before = after
    env.close()
    return task, ours, theirs


def test_observations_agree_at_the_start_and_after_every_step(rollout):
    task, ours, theirs = rollout
    seen = np.array([observation for observation, _, _ in theirs])
    mine = gymnasium_view(task, np.array([observation for observation, _, _ in ours]))
    if task.name == "humanoid":  # contact forces are zero with us
        mine, seen = mine[:, :-78], seen[:, :-78]
    np.testing.assert_allclose(mine, seen, rtol=1e-9, atol=1e-9)


def test_contact_forces_are_not_observed(rollout):
    task, ours, _ = rollout
    if task.name == "humanoid":
        assert not np.array([observation for observation, _, _ in ours])[:, -84:].any()


def test_episodes_end_at_the_same_step(rollout):
    task, ours, theirs = rollout
    assert [ended for _, _, ended in ours] == [ended for _, _, ended in theirs]
    assert any(ended for _, _, ended in ours) == (task.name != "half_cheetah")


def test_rewards_agree_except_for_the_bonus_of_the_failing_step(rollout):
    """Random-envs pays the bonus for being alive on every step, Gymnasium's v5 not after a fall."""
    task, ours, theirs = rollout
    bonus = ALIVE[task.name] * np.array([ended for _, _, ended in theirs])
    expected = np.array([reward for _, reward, _ in theirs]) + bonus
    np.testing.assert_allclose([reward for _, reward, _ in ours], expected, rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize(
    ("name", "coordinate", "value", "ended"),
    [
        ("hopper", 1, 0.71, False),
        ("hopper", 1, 0.69, True),
        ("hopper", 2, 0.19, False),
        ("hopper", 2, 0.21, True),
        ("hopper", 3, 101.0, True),
        ("half_cheetah", 1, -5.0, False),
        ("half_cheetah", 2, 3.1, False),
        ("walker2d", 1, 0.81, False),
        ("walker2d", 1, 0.79, True),
        ("walker2d", 1, 2.01, True),
        ("walker2d", 2, -0.99, False),
        ("walker2d", 2, -1.01, True),
        ("humanoid", 2, 1.01, False),
        ("humanoid", 2, 0.99, True),
        ("humanoid", 2, 2.01, True),
    ],
)
def test_a_robot_has_fallen_when_too_low_too_high_or_too_tilted(name, coordinate, value, ended):
    task = get_task(name)
    state = task.initial(1, np.random.default_rng(0))
    state.qpos[0, coordinate] = value
    assert task.terminated(State(state.qpos, state.qvel))[0] == ended
