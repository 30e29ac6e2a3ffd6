"""The two training backends are one algorithm: the same batch and weights, the same update."""

import numpy as np
import pytest
import torch
from scipy.stats import mannwhitneyu
from stable_baselines3.common.logger import configure

from adr_service.distributions import Gaussian, Uniform
from adr_service.randomness import stream
from adr_service.simulation.vec_env import RandomizedVecEnv
from adr_service.tasks.catalogue import get_task, hidden_of, source_of
from adr_service.training.sac import BACKENDS, train
from adr_service.training.settings import TrainingSettings

pytestmark = pytest.mark.filterwarnings("ignore::DeprecationWarning")
ARM, SOURCE = get_task("arm"), source_of("arm", "vanilla")
BATCH, RATE = 64, 1e-2
CURVE = {
    "max_steps": 20_000,
    "gradient_steps": 6,
    "hidden": [64, 64],
    "activation": "relu",
    "batch_size": 128,
    "learning_starts": 1000,
    "evaluate_every": 1000,
    "evaluation_episodes": 24,
    "stop_at_threshold": False,
}


@pytest.fixture
def no_noise(monkeypatch):
    """Both libraries draw the mean of every action: their random numbers cannot be equal."""
    import jax

    zeros = lambda key, shape=(), dtype=float, **_: jax.numpy.zeros(shape, dtype)  # noqa: E731
    monkeypatch.setattr(jax.random, "normal", zeros)
    standard = "torch.distributions.normal._standard_normal"
    monkeypatch.setattr(standard, lambda shape, dtype, device: torch.zeros(shape, dtype=dtype))


def build(name, activation):
    given = {"hidden": [16, 16], "batch_size": BATCH, "activation": activation}
    settings = TrainingSettings.model_validate(given)
    env = RandomizedVecEnv(ARM, SOURCE, Gaussian.prior(SOURCE.space), 4, np.random.default_rng(0))
    common = {"seed": 1, "learning_rate": RATE, "batch_size": BATCH}
    model = BACKENDS[name].build(env, settings, common)
    model.set_logger(configure(None, []))
    model._last_obs = env.reset()
    rng = np.random.default_rng(3)
    for _ in range(30):
        observations, following = rng.normal(size=(2, 4, 4))
        ended = rng.random(4) < 0.3
        infos = [{"TimeLimit.truncated": bool(cut)} for cut in ended & (rng.random(4) < 0.5)]
        model.replay_buffer.add(
            observations,
            following,
            np.tanh(rng.normal(size=(4, 2))),
            rng.normal(size=4),
            ended,
            infos,
        )
    return model


def update(model):
    """One update, on a batch of SB3's own indices."""
    np.random.seed(5)  # noqa: NPY002 - which SB3 draws from
    model.train(gradient_steps=1, batch_size=BATCH)


def weights(sbx, target=False):
    """SBX's weights under SB3's names."""
    actor = sbx.policy.actor_state.params["params"]
    names = ("actor.latent_pi.0", "actor.latent_pi.2", "actor.mu", "actor.log_std")
    layers_of = {name: (actor[f"Dense_{i}"], ()) for i, name in enumerate(names)}
    for prefix, params in (
        ("critic", sbx.policy.qf_state.params),
        ("critic_target", sbx.policy.qf_state.target_params),
    ):
        layers = params["params"]["VmapContinuousCritic_0"]
        for i in range(3):
            for q in range(2):
                layers_of[f"{prefix}.qf{q}.{2 * i}"] = (layers[f"Dense_{i}"], (q,))
    return {
        f"{name}.{kind}": torch.as_tensor(np.array(layer[key][at]).T.copy())
        for name, (layer, at) in layers_of.items()
        for kind, key in (("weight", "kernel"), ("bias", "bias"))
    }


@pytest.mark.parametrize("activation", ["tanh", "relu"])
def test_one_update_is_the_same_in_both_backends(no_noise, activation):
    """Actor, critics, their targets and the temperature after one update, to float32's rounding
    after Adam, whose first step is the learning rate times a sign."""
    sbx, sb3 = build("sbx", activation), build("sb3", activation)
    before = weights(sbx)
    sb3.policy.load_state_dict(before)
    update(sbx)
    update(sb3)
    sbx.publish()
    after = weights(sbx)
    for name, expected in sb3.policy.state_dict().items():
        moved = (after[name] - before[name]).abs().max()
        assert moved > 0.001 * RATE, name
        # rounding decides the sign of a gradient near zero: a few weights in a thousand
        differ = (expected - after[name]).abs() > 0.01 * RATE
        assert differ.float().mean() < 0.005, name
    temperature = float(np.exp(sbx.ent_coef_state.params["log_ent_coef"]))
    assert temperature == pytest.approx(float(torch.exp(sb3.log_ent_coef.detach())), rel=1e-5)
    assert temperature != 1.0


def test_the_next_actions_come_from_the_updated_actor(no_noise):
    """Without noise, an action is the mode of the updated actor's distribution."""
    sbx = build("sbx", "tanh")
    before, _ = sbx.predict(sbx._last_obs, deterministic=True)
    update(sbx)
    sbx.publish()
    expected, _ = sbx.predict(sbx._last_obs, deterministic=True)
    actions, unit = sbx._sample_action(0, None, 4)
    np.testing.assert_allclose(actions, expected, atol=1e-6)
    np.testing.assert_allclose(unit, actions, atol=1e-6)  # the arm's bounds are -1 and 1
    assert np.abs(expected - before).max() > 1e-4


@pytest.mark.slow
def test_the_learning_curves_of_both_backends_overlap():
    """An exact Mann-Whitney test at 1 % on the mean evaluations of five seeds each.

    With five and five seeds it rejects only if all seeds of one exceed all of the other. It does
    reject a learning rate thirty times too small, so it has power.
    """

    def areas(backend, **changes):
        given = {**CURVE, "backend": backend, **changes}
        settings = TrainingSettings.model_validate(given)
        truth = Uniform.point(SOURCE.space, hidden_of("arm", "vanilla").values)
        trained = [train(ARM, SOURCE, truth, settings, stream("curve", seed)) for seed in range(5)]
        return [np.mean([point.mean_return for point in training.curve]) for training in trained]

    sbx, sb3, slow = areas("sbx"), areas("sb3"), areas("sbx", learning_rate=ARM.learning_rate / 30)
    assert mannwhitneyu(sbx, sb3, method="exact").pvalue > 0.01
    assert mannwhitneyu(sbx, slow, method="exact").pvalue < 0.01
