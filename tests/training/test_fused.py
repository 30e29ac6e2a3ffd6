"""The fused algorithms are the libraries' own: the same batch and weights, the same update."""

from itertools import product

import numpy as np
import pytest
import torch
from scipy.stats import mannwhitneyu
from stable_baselines3.common.logger import configure

from adr_service.distributions import Gaussian, Uniform
from adr_service.randomness import stream
from adr_service.simulation.vec_env import RandomizedVecEnv
from adr_service.tasks.catalogue import get_task, hidden_of, source_of
from adr_service.training.settings import SacSettings
from adr_service.training.train import LIBRARIES, train
from tests.training.examples import settings

pytestmark = pytest.mark.filterwarnings("ignore::DeprecationWarning")
ARM, SOURCE = get_task("arm"), source_of("arm", "vanilla")
BATCH, RATE = 64, 1e-2
SAC_ACTOR = ("actor.latent_pi.0", "actor.latent_pi.2", "actor.mu", "actor.log_std")
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


def build(algorithm, backend, activation="relu"):
    """A model with a filled replay buffer, of one seed."""
    given = settings(
        algorithm, backend, batch_size=BATCH, activation=activation, learning_rate=RATE
    )
    env = RandomizedVecEnv(ARM, SOURCE, Gaussian.prior(SOURCE.space), 4, np.random.default_rng(0))
    return filled(LIBRARIES[algorithm][backend].build(env, ARM, given, seed=1))


def filled(model):
    model.set_logger(configure(None, []))
    model._last_obs = model.env.reset()
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


def sac_weights(sbx):
    """SBX's weights under SB3's names."""
    actor, critics = sbx.policy.actor_state.params["params"], sbx.policy.qf_state
    layers = {name: (actor[f"Dense_{i}"], ()) for i, name in enumerate(SAC_ACTOR)}
    for prefix, params in (("critic", critics.params), ("critic_target", critics.target_params)):
        dense = params["params"]["VmapContinuousCritic_0"]
        for i, q in product(range(3), range(2)):
            layers[f"{prefix}.qf{q}.{2 * i}"] = (dense[f"Dense_{i}"], (q,))
    return {name: torch.as_tensor(array) for name, array in named(layers)}


def named(layers):
    """PyTorch's names and arrays of Flax's layers."""
    for name, (layer, at) in layers.items():
        for kind, key in (("weight", "kernel"), ("bias", "bias")):
            yield f"{name}.{kind}", np.array(layer[key][at]).T.copy()


def crossq_weights(sbx):
    """SBX's weights and statistics under SB3-Contrib's names."""
    found = {}
    actor, critics = sbx.policy.actor_state, sbx.policy.qf_state
    norms, linears = (0, 3, 6), (1, 4)
    for i, at in enumerate(linears):
        found |= dict(named({f"actor.latent_pi.{at}": (actor.params[f"Dense_{i}"], ())}))
    heads = {
        "actor.mu": (actor.params["Dense_2"], ()),
        "actor.log_std": (actor.params["Dense_3"], ()),
    }
    found |= dict(named(heads))
    for i, at in enumerate(norms):
        found |= renormalisation(f"actor.latent_pi.{at}", actor, f"BatchRenorm_{i}", ())
    dense = critics.params["VmapCritic_0"]
    for i, q in product(range(3), range(2)):
        found |= dict(named({f"critic.qf{q}.{(1, 4, 7)[i]}": (dense[f"Dense_{i}"], (q,))}))
        name = f"critic.qf{q}.{norms[i]}"
        found |= renormalisation(name, critics, ("VmapCritic_0", f"BatchRenorm_{i}"), (q,))
    return {name: torch.as_tensor(array) for name, array in found.items()}


def renormalisation(name, state, path, at):
    trees = [state.params, state.batch_stats]
    for part in (path,) if isinstance(path, str) else path:
        trees = [tree[part] for tree in trees]
    given = {**trees[0], "ra_mean": trees[1]["mean"], "ra_var": trees[1]["var"]}
    given["steps"] = trees[1]["steps"]
    kept = ("scale", "bias", "ra_mean", "ra_var", "steps")
    return {f"{name}.{each}": np.array(given[each])[at] for each in kept}


@pytest.mark.parametrize(
    ("algorithm", "weights", "activation"),
    [
        ("sac", sac_weights, "relu"),
        ("crossq", crossq_weights, "tanh"),
        pytest.param("sac", sac_weights, "tanh", marks=pytest.mark.slow),
        pytest.param("crossq", crossq_weights, "relu", marks=pytest.mark.slow),
    ],
)
def test_one_update_is_the_same_in_both_backends(no_noise, algorithm, weights, activation):
    """Actor, critics, what normalises or follows them, and the temperature after one update.

    To float32's rounding after Adam, whose first step is the learning rate times a sign. The
    libraries' batch variances differ by the factor n / (n - 1). Without noise, the gradient of the
    weights of CrossQ's log deviation is the mean of what was normalised to zero mean: rounding.
    """
    sbx, sb3 = (build(algorithm, backend, activation) for backend in ("sbx", "sb3"))
    before = weights(sbx)
    sb3.policy.load_state_dict(before)
    if algorithm == "crossq":  # whose actor is updated in every third update
        sbx._n_updates = sb3._n_updates = 2
    update(sbx)
    update(sb3)
    sbx.publish()
    after = weights(sbx)
    for name, expected in sb3.policy.state_dict().items():
        moved = (after[name] - before[name]).abs().max()
        assert moved > 0.001 * RATE, name
        if (algorithm, name) == ("crossq", "actor.log_std.weight"):
            continue
        # rounding decides the sign of a gradient near zero: of few weights
        differ = (expected - after[name]).abs() > 0.02 * RATE
        assert differ.sum() <= max(1, 0.02 * differ.numel()), name
    temperature = float(np.exp(sbx.ent_coef_state.params["log_ent_coef"]))
    assert temperature == pytest.approx(float(torch.exp(sb3.log_ent_coef.detach())), rel=1e-5)
    assert temperature != 1.0


@pytest.mark.parametrize(
    ("algorithm", "stock", "updates"),
    [
        ("sac", "SAC", 4),
        # one of two moves the actor too
        *(pytest.param("crossq", "CrossQ", n, marks=pytest.mark.slow) for n in (2, 13)),
    ],
)
def test_several_updates_are_those_of_the_stock_library(algorithm, stock, updates):
    """Both draw the same random numbers, so that only rounding differs."""
    import jax
    import sbx

    fused = build(algorithm, "sbx")
    fused._n_updates = 1
    own = type(fused).__mro__[2]
    assert own is getattr(sbx, stock)
    plain = build(algorithm, "sbx")
    plain._n_updates = 1
    np.random.seed(5)  # noqa: NPY002
    own.train(plain, gradient_steps=updates, batch_size=BATCH)
    np.random.seed(5)  # noqa: NPY002
    fused.train(gradient_steps=updates, batch_size=BATCH)
    fused.publish()
    for state in ("qf_state", "actor_state"):
        expected, found = (jax.tree.leaves(getattr(m.policy, state)) for m in (plain, fused))
        for each, other in zip(found, expected, strict=True):
            np.testing.assert_allclose(each, other, rtol=1e-3, atol=1e-5)


@pytest.mark.parametrize("algorithm", ["sac", "crossq"])
def test_the_compiled_program_of_many_updates_is_no_larger_than_that_of_some(algorithm):
    """It would take hours to compile."""
    model = build(algorithm, "sbx")

    def lines(updates):
        given = model._arrays, model._sample(updates * BATCH), model._last_obs, 0
        return model._compile(updates).lower(*given).as_text().count("\n")

    assert lines(1000) == pytest.approx(lines(20), rel=0.05)


@pytest.mark.parametrize(("algorithm", "activation"), [("sac", "relu"), ("crossq", "tanh")])
def test_the_next_actions_come_from_the_updated_actor(no_noise, algorithm, activation):
    """No noise is drawn here, so the action is the mode of the updated actor."""
    sbx = build(algorithm, "sbx", activation)
    sbx._n_updates = 2  # CrossQ's next update is one of the actor, too
    before, _ = sbx.predict(sbx._last_obs, deterministic=True)
    update(sbx)
    sbx.publish()
    expected, _ = sbx.predict(sbx._last_obs, deterministic=True)
    actions, unit = sbx._sample_action(0, None, 4)
    np.testing.assert_allclose(actions, expected, atol=1e-6)
    np.testing.assert_allclose(unit, actions, atol=1e-6)  # the arm's bounds are -1 and 1
    assert np.abs(expected - before).max() > 1e-4


def drawn_as_by_pytorch(model, seed):
    """Give SBX's SAC initial weights as PyTorch draws them; Flax's have 1.7 times the deviation."""
    import jax

    rng = np.random.default_rng(seed)

    def drawn(tree):
        if "kernel" not in tree:
            return {name: drawn(inner) for name, inner in tree.items()}
        bound = tree["kernel"].shape[-2] ** -0.5
        return {
            name: jax.numpy.asarray(rng.uniform(-bound, bound, x.shape), x.dtype)
            for name, x in tree.items()
        }

    actor, critics = model.policy.actor_state, model.policy.qf_state
    weights = drawn(critics.params)
    model.policy.actor_state = actor.replace(params=drawn(actor.params))
    copy = jax.tree.map(jax.numpy.array, weights)
    model.policy.qf_state = critics.replace(params=weights, target_params=copy)
    model.adopt()
    return model


@pytest.mark.slow
def test_the_learning_curves_of_both_backends_overlap(monkeypatch):
    """An exact Mann-Whitney test at 1 % on the mean evaluations of five seeds each.

    With five and five seeds it rejects only if all seeds of one exceed all of the other. It does
    reject a learning rate thirty times too small, so it has power. Initial weights are drawn alike.
    """
    library = LIBRARIES["sac"]["sbx"]

    class DrawnAsByPyTorch(type(library)):
        def build(self, env, task, settings, seed):
            return drawn_as_by_pytorch(super().build(env, task, settings, seed), seed)

    monkeypatch.setitem(LIBRARIES["sac"], "sbx", DrawnAsByPyTorch())

    def areas(backend, **changes):
        given = SacSettings.model_validate({**CURVE, "backend": backend, **changes})
        truth = Uniform.point(SOURCE.space, hidden_of("arm", "vanilla").values)
        trained = [train(ARM, SOURCE, truth, given, stream("curve", seed)) for seed in range(5)]
        return [np.mean([point.mean_return for point in training.curve]) for training in trained]

    sbx, sb3, slow = areas("sbx"), areas("sb3"), areas("sbx", learning_rate=ARM.learning_rate / 30)
    assert mannwhitneyu(sbx, sb3, method="exact").pvalue > 0.01
    assert mannwhitneyu(sbx, slow, method="exact").pvalue < 0.01
