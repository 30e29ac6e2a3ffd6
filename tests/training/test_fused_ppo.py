"""The fused PPO is the libraries' own: the same rollout and weights, the same update."""

import numpy as np
import pytest
import torch
from gymnasium.spaces import Box
from stable_baselines3.common.buffers import RolloutBuffer
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.logger import configure

from adr_service.distributions import Gaussian
from adr_service.simulation.vec_env import RandomizedVecEnv
from adr_service.tasks.catalogue import get_task, source_of
from adr_service.training.train import LIBRARIES
from tests.training.examples import settings

pytest.importorskip("sbx")
from adr_service.training.fused_ppo import Rollout, _advantages, _Log

pytestmark = pytest.mark.filterwarnings("ignore::DeprecationWarning")
ARM, SOURCE = get_task("arm"), source_of("arm", "vanilla")
STEPS, ENVIRONMENTS, RATE = 16, 4, 1e-2


def build(backend, activation="tanh", **others):
    """A model whose update is one minibatch of a whole rollout, and its environments."""
    whole = {
        "environments": ENVIRONMENTS,
        "rollout_steps": STEPS,
        "batch_size": STEPS * ENVIRONMENTS,
        "epochs": 1,
        "entropy_coefficient": 0.01,
    }
    given = settings("ppo", backend, activation=activation, learning_rate=RATE, **(whole | others))
    env = RandomizedVecEnv(
        ARM, SOURCE, Gaussian.prior(SOURCE.space), ENVIRONMENTS, np.random.default_rng(0)
    )
    model = LIBRARIES["ppo"][backend].build(env, ARM, given, seed=1)
    model.set_logger(configure(None, []))
    return model


def a_rollout():
    rng = np.random.default_rng(3)
    n = STEPS * ENVIRONMENTS
    observations, actions = rng.normal(size=(n, 4)), rng.normal(size=(n, 2))
    # of a standard normal distribution, with which the actors begin
    probabilities = -0.5 * (actions**2 + np.log(2 * np.pi)).sum(axis=1)
    columns = (observations, actions, rng.normal(size=n), 0.1 * rng.normal(size=n), probabilities)
    return Rollout(*(column.astype(np.float32) for column in columns))


def weights(sbx):
    """SBX's weights under SB3's names."""
    actor, critic = (
        state.params["params"] for state in (sbx.policy.actor_state, sbx.policy.vf_state)
    )
    layers = {
        "mlp_extractor.policy_net.0": actor["Dense_0"],
        "mlp_extractor.policy_net.2": actor["Dense_1"],
        "action_net": actor["Dense_2"],
        "mlp_extractor.value_net.0": critic["Dense_0"],
        "mlp_extractor.value_net.2": critic["Dense_1"],
        "value_net": critic["Dense_2"],
    }
    found = {
        f"{name}.{kind}": torch.as_tensor(np.array(layer[key]).T.copy())
        for name, layer in layers.items()
        for kind, key in (("weight", "kernel"), ("bias", "bias"))
    }
    if "log_std" in actor:
        found["log_std"] = torch.as_tensor(np.array(actor["log_std"]))
    return found


def fill(buffer, rollout):
    """Put a rollout into SB3's buffer, which flattens by environment."""
    for name, column in zip(
        ("observations", "actions", "advantages", "returns", "log_probs"), rollout, strict=True
    ):
        setattr(buffer, name, column.reshape(STEPS, ENVIRONMENTS, *column.shape[1:]))
    buffer.values = np.zeros((STEPS, ENVIRONMENTS), np.float32)
    buffer.pos, buffer.full, buffer.generator_ready = STEPS, True, False


@pytest.mark.parametrize(("activation", "bins"), [("tanh", None), ("relu", None), ("tanh", 5)])
def test_one_update_is_the_same_in_both_backends(activation, bins):
    """In the direction of Adam's first step: the learning rate times a gradient's sign.

    Not more closely, because SB3 clips the gradients of both networks together, SBX each of them:
    gradients near Adam's epsilon then move their weights by other parts of the learning rate.
    """
    sbx, sb3 = (build(backend, activation, action_bins=bins) for backend in ("sbx", "sb3"))
    before = weights(sbx)
    sb3.policy.load_state_dict(before)
    rollout = a_rollout()
    if bins is not None:
        numbers = np.random.default_rng(4).integers(bins, size=rollout.actions.shape)
        chance = np.full(len(numbers), -2 * np.log(bins), np.float32)  # of two actions
        rollout = rollout._replace(actions=numbers, log_probabilities=chance)
    sbx._rollout = rollout
    sbx.train()
    fill(sb3.rollout_buffer, rollout)
    sb3.train()
    after = weights(sbx)
    for name, expected in sb3.policy.state_dict().items():
        assert (after[name] - before[name]).abs().max() > 0.5 * RATE, name
        differ = (expected - after[name]).abs() > 0.5 * RATE
        assert differ.float().mean() < 0.01, name


class Rates(BaseCallback):
    """The learning rate of the update before each rollout; of the first, that of no update."""

    def __init__(self):
        super().__init__()
        self.seen = []

    def _on_step(self):
        if self.n_calls % STEPS == 1:
            policy = self.model.policy
            if hasattr(policy, "actor_state"):
                states = (policy.actor_state, policy.vf_state)
                rates = [state.opt_state[1].hyperparams["learning_rate"] for state in states]
            else:
                rates = [group["lr"] for group in policy.optimizer.param_groups]
            self.seen.append(rates)
        return True


@pytest.mark.parametrize("backend", ["sbx", "sb3"])
@pytest.mark.parametrize(
    ("schedule", "shares"), [("constant", [1, 1, 1, 1]), ("linear", [1, 0.75, 0.5, 0.25])]
)
def test_the_learning_rate_follows_its_schedule(backend, schedule, shares):
    model, rates = build(backend, learning_rate_schedule=schedule), Rates()
    model.learn(4 * STEPS * ENVIRONMENTS, callback=rates)
    for seen, share in zip(rates.seen, shares, strict=True):
        np.testing.assert_allclose(seen, share * RATE)


def test_an_epoch_updates_on_every_transition_once():
    """The update that is called here counts the transitions that it is given."""
    model = build("sbx", batch_size=16, epochs=3)
    rollout = a_rollout()
    count = len(rollout.advantages)
    numbered = rollout._replace(returns=np.arange(count))
    model._one_update = lambda seen, calls, *columns: (
        (seen.at[columns[3]].add(1), calls + 1),
        None,
    )
    compiled = model._compile()
    seen, calls, _ = compiled(np.zeros(count), 0, model.normalisation, numbered, model.key)
    assert calls == 3 * count / 16
    np.testing.assert_array_equal(seen, np.full(count, 3))


def test_three_epochs_are_three_updates_on_the_whole_rollout():
    once, thrice = build("sbx"), build("sbx", epochs=3)
    once._normal.update = lambda seen: None  # else it changes between the updates
    for model, calls in ((once, 3), (thrice, 1)):
        model._rollout = a_rollout()
        for _ in range(calls):
            model.train()
    for name, expected in weights(once).items():
        np.testing.assert_allclose(weights(thrice)[name], expected, rtol=1e-3, atol=1e-5)


def test_advantages_are_those_of_sb3s_buffer():
    """Some episodes end within the rollout, some with its last step."""
    rng = np.random.default_rng(0)
    rewards, values = rng.normal(size=(STEPS, 3)), rng.normal(size=(STEPS + 1, 3))
    dones = rng.random((STEPS, 3)) < 0.2
    dones[-1] = [True, False, True]
    space = Box(-1, 1, (1,))
    buffer = RolloutBuffer(STEPS, space, space, "cpu", gae_lambda=0.9, gamma=0.8, n_envs=3)
    starts = np.ones(3)
    for step in range(STEPS):
        nothing = np.zeros((3, 1))
        known = (torch.as_tensor(values[step]), torch.zeros(3))
        buffer.add(nothing, nothing, rewards[step], starts, *known)
        starts = dones[step]
    buffer.compute_returns_and_advantage(torch.as_tensor(values[-1]), dones[-1])
    given = (rewards.astype(np.float32), values.astype(np.float32), dones, 0.8, 0.9)
    np.testing.assert_allclose(_advantages(*given), buffer.advantages, rtol=1e-4, atol=1e-6)


def test_an_episode_that_the_time_limit_cuts_is_continued_by_its_value():
    model = build("sbx", gamma=0.5)
    last = np.random.default_rng(1).normal(size=(5, 4)).astype(np.float32)
    rewards = np.zeros((STEPS, ENVIRONMENTS), np.float32)
    places = [(0, 1), (3, 2), (3, 3), (7, 0), (9, 1)]
    model._continue(rewards, [(*place, seen) for place, seen in zip(places, last, strict=True)])
    values = model.vf.apply(model.policy.vf_state.params, last).flatten()
    np.testing.assert_allclose([rewards[place] for place in places], 0.5 * values, rtol=1e-5)
    assert np.count_nonzero(rewards) == len(places)


def test_the_time_limit_cuts_episodes_in_a_rollout():
    """The arm's episodes end by their time limit alone, after 200 steps."""
    continued = []
    model = build("sbx")
    model._continue = lambda rewards, cut: continued.append([step for step, *_ in cut])
    model.learn(13 * STEPS * ENVIRONMENTS)
    assert continued[:12] == [[]] * 12
    assert set(continued[12]) == {200 - 12 * STEPS - 1}


def test_observations_are_normalised_by_those_of_the_rollouts_before():
    model = build("sbx")
    np.testing.assert_array_equal(model.normalisation[0], np.zeros(4))
    model.learn(STEPS * ENVIRONMENTS)
    seen = model._rollout.observations
    mean, scale = model.normalisation
    np.testing.assert_allclose(mean, seen.mean(axis=0), atol=1e-4)
    np.testing.assert_allclose(scale, 1 / seen.std(axis=0), rtol=1e-2)


def test_a_discounted_return_begins_anew_where_its_episode_ends():
    model, seen = build("sbx", gamma=0.5), []
    model._discounted.update = lambda returns: seen.append(returns.tolist())
    for dones in ([True, False, False, False], [False] * 4):
        model._note_returns(np.ones(ENVIRONMENTS), np.array(dones))
    assert seen == [[1.0] * 4, [1.0, 1.5, 1.5, 1.5]]


def test_rewards_are_divided_by_the_deviation_of_returns():
    """Where all values are zero and lambda too, an advantage is its own reward."""
    model, rewards = build("sbx", gae_lambda=0.0), np.random.default_rng(0).normal(size=(3, 4))
    model._discounted.var = np.array(4.0)
    model._values = lambda observations: np.zeros(observations.shape[:-1], np.float32)
    log = _Log(3, ENVIRONMENTS, model.observation_space, model.action_space)
    for step, each in enumerate(rewards):
        log.note(step, each, np.zeros(ENVIRONMENTS, bool), [{}] * ENVIRONMENTS)
    advantages = model._rollout_of(log).advantages
    np.testing.assert_allclose(advantages, rewards.ravel() / 2, rtol=1e-6)
