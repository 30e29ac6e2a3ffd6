"""Trainings by all algorithms and backends: repeatable, cancellable, stopped at the threshold."""

import numpy as np
import pytest

from adr_service.distributions import Gaussian, Uniform
from adr_service.errors import InvalidInput
from adr_service.progress import StageCancelled
from adr_service.randomness import stream
from adr_service.simulation.vec_env import RandomizedVecEnv
from adr_service.tasks.catalogue import get_task, variants_of
from adr_service.training.networks import from_bytes, to_bytes
from adr_service.training.train import LIBRARIES, train
from tests.training.examples import settings

ARM = get_task("arm")
VANILLA = variants_of(ARM.name)["vanilla"]
TRUTH = Uniform.point(VANILLA.source.space, VANILLA.hidden.values)
PRIOR = Gaussian.prior(VANILLA.source.space)
SBX = pytest.mark.filterwarnings("ignore::DeprecationWarning")
CASES = [
    pytest.param(algorithm, backend, marks=SBX if backend == "sbx" else ())
    for algorithm, backends in LIBRARIES.items()
    for backend in backends
]
# compiling CrossQ for each test would take a third of this file's time
MOSTLY_QUICK = [
    pytest.param(*case.values, marks=[*case.marks, pytest.mark.slow])
    if case.values == ("crossq", "sbx")
    else case
    for case in CASES
]


@pytest.mark.parametrize("backend", ["sb3", pytest.param("sbx", marks=SBX)])
def test_a_policy_of_bins_takes_the_mean_of_the_librarys_draws(backend):
    given = settings("ppo", backend, action_bins=5, learning_rate=0.02)
    env = RandomizedVecEnv(ARM, VANILLA.source, PRIOR, 12, np.random.default_rng(0))
    library = LIBRARIES["ppo"][backend]
    model = library.build(env, ARM, given, seed=1)
    model.learn(480)
    seen = np.random.default_rng(1).normal(size=(20, 4)).astype(np.float32)
    drawn = model.predict(seen_by(model, np.tile(seen, (5000, 1))), deterministic=False)[0]
    expected = (drawn / 2 - 1).reshape(5000, 20, 2).mean(axis=0)
    assert expected.std() > 0.1
    policy = library.policy(model, ARM, given)
    np.testing.assert_allclose(policy.act(seen), expected, atol=0.05)
    assert len(policy.to_bytes()) > given.policy_bytes(4, 2) > len(policy.to_bytes()) - 1000


@pytest.mark.parametrize("backend", ["sb3", pytest.param("sbx", marks=SBX)])
def test_ppos_first_mean_actions_are_near_zero_with_orthogonal_layers(backend):
    seen = np.random.default_rng(1).normal(size=(50, 4)).astype(np.float32)
    env = RandomizedVecEnv(ARM, VANILLA.source, PRIOR, 12, np.random.default_rng(0))
    library, sizes = LIBRARIES["ppo"][backend], []
    for given in (settings("ppo", backend), settings("ppo", backend, ortho_init=False)):
        policy = library.policy(library.build(env, ARM, given, seed=1), ARM, given)
        sizes.append(np.abs(policy.act(seen)).max())
    assert sizes[0] < 0.1 < sizes[1]


@pytest.mark.parametrize("backend", ["sb3", pytest.param("sbx", marks=SBX)])
def test_policies_of_ppo_ignore_masses_that_are_constant_in_training(backend):
    """Humanoid observes the masses of its bodies, and the unmodeled variant freezes four.

    That of the world is always 0.
    """
    task, source = get_task("humanoid"), variants_of("humanoid")["unmodeled"].source
    env = RandomizedVecEnv(task, source, Gaussian.prior(source.space), 12, np.random.default_rng(0))
    given, library = settings("ppo", backend), LIBRARIES["ppo"][backend]
    model = library.build(env, task, given, seed=1)
    model.learn(480)
    (weight, _), *_ = library.policy(model, task, given).layers
    masses = [i for i, name in enumerate(task.columns) if name.endswith("inertia_m [SI]")]
    ignored = [task.columns[i] for i in masses if not weight[:, i].any()]
    frozen = ("world", "torso", "lwaist", "pelvis", "right_thigh")
    assert ignored == [f"{body}_inertia_m [SI]" for body in frozen]


def test_an_error_of_a_training_that_has_not_diverged_stays_what_it_is():
    def fail(fraction, **facts):
        raise OSError("no space left")

    with pytest.raises(OSError, match="no space left"):
        trained("sac", "sb3", progress=fail)


def test_the_reported_policy_is_the_averaged_one_where_that_is_asked_for():
    """Over many steps all policies count alike, and the first one's bias is 0."""
    mean, last = (
        trained("ppo", "sb3", averaged_steps=steps, stop_at_threshold=False).policy.layers[-1][1]
        for steps in (10**6, 0)
    )
    assert 0.1 < np.linalg.norm(mean) / np.linalg.norm(last) < 0.9


# what stops a training is the same for both backends, but PPO's rollouts on SBX are our own
STOPPED = [("sac", "sb3"), ("crossq", "sb3"), ("ppo", "sb3"), pytest.param("ppo", "sbx", marks=SBX)]


def trained(algorithm, backend, progress=lambda fraction, **facts: None, task=ARM, **others):
    given = settings(algorithm, backend, **others)
    return train(task, VANILLA.source, PRIOR, given, stream("test", 1), progress=progress)


@pytest.mark.parametrize(("algorithm", "backend"), CASES)
def test_the_policy_acts_as_the_librarys_own(algorithm, backend):
    """Weights and normalisation are in the right layers: equal to float32's rounding."""
    given = settings(algorithm, backend, max_steps=720)
    env = RandomizedVecEnv(ARM, VANILLA.source, PRIOR, 12, np.random.default_rng(0))
    library = LIBRARIES[algorithm][backend]
    model = library.build(env, ARM, given, seed=1)
    model.learn(720)
    seen = np.random.default_rng(1).normal(size=(50, 4)).astype(np.float32)
    policy = library.policy(model, ARM, given)
    expected = model.predict(seen_by(model, seen), deterministic=True)[0]
    np.testing.assert_allclose(policy.act(seen), np.clip(expected, -1, 1), atol=1e-5)


@pytest.mark.parametrize(("algorithm", "backend"), MOSTLY_QUICK)
class TestTrain:
    def test_the_same_seed_gives_the_same_bytes_and_leaves_no_file(
        self, algorithm, backend, tmp_path, monkeypatch
    ):
        """Whatever the state of NumPy's global generator."""
        np.random.seed(1)  # noqa: NPY002
        first = trained(algorithm, backend)
        monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
        np.random.seed(2)  # noqa: NPY002
        second = trained(algorithm, backend)
        assert first.policy.to_bytes() == second.policy.to_bytes()
        assert first.curve == second.curve
        assert [point.steps for point in first.curve] == [240, 480]
        assert first.steps == 480
        assert not first.reached_threshold
        assert list(tmp_path.iterdir()) == []

    def test_a_training_that_diverges_says_so(self, algorithm, backend):
        """The library's own message speaks of the next action alone."""
        with pytest.raises(InvalidInput, match="training diverged: the actor"):
            trained(algorithm, backend, learning_rate=1e3, stop_at_threshold=False)

    def test_progress_ends_at_the_whole(self, algorithm, backend):
        """All environments take the last step, also where fewer would do."""
        fractions = []
        trained(
            algorithm,
            backend,
            progress=lambda fraction, **facts: fractions.append(fraction),
            max_steps=485,
            evaluate_every=485,
        )
        assert fractions == sorted(fractions)
        assert fractions[-1] == 1

    def test_a_model_that_is_started_from_networks_is_where_they_were(self, algorithm, backend):
        """Its policy and all that it learns from, but its optimiser, are those that were left."""
        given, library = settings(algorithm, backend), LIBRARIES[algorithm][backend]
        models = []
        for seed in (1, 2):
            env = RandomizedVecEnv(ARM, VANILLA.source, PRIOR, 12, np.random.default_rng(0))
            models.append(library.build(env, ARM, given, seed))
        models[0].learn(480)
        left = from_bytes(to_bytes(library.networks(models[0])))
        library.load(models[1], left)
        for found, expected in zip(*(learned(model) for model in models[::-1]), strict=True):
            np.testing.assert_array_equal(found, expected)
        first, second = (library.policy(model, ARM, given).to_bytes() for model in models)
        assert first == second
        models[1].learn(480)
        assert library.policy(models[1], ARM, given).to_bytes() != second


@pytest.mark.parametrize(("algorithm", "backend"), STOPPED)
class TestStop:
    def test_training_stops_at_the_threshold(self, algorithm, backend):
        """The arm's first evaluation already earns something."""
        training = trained(algorithm, backend, task=type(ARM)(reward_threshold=0.01))
        assert training.steps == 240
        assert training.reached_threshold

    def test_a_training_goes_on_beyond_the_threshold_if_asked_to(self, algorithm, backend):
        easy = type(ARM)(reward_threshold=0.01)
        training = trained(algorithm, backend, task=easy, stop_at_threshold=False)
        assert (training.steps, training.reached_threshold) == (480, True)

    def test_a_training_stops_when_its_progress_raises_a_cancellation(self, algorithm, backend):
        def stop(fraction, **facts):
            if fraction > 0.3:
                raise StageCancelled

        with pytest.raises(StageCancelled):
            trained(algorithm, backend, progress=stop)


def learned(model):
    """All arrays that a model learns, but its optimisers', as its library has them."""
    if not hasattr(model.policy, "actor_state"):
        arrays = [tensor.numpy() for tensor in model.policy.state_dict().values()]
        normal = model.get_vec_normalize_env()
        if normal is None:
            return [*arrays, model.log_ent_coef.detach().numpy()]
        return arrays + [x for rms in (normal.obs_rms, normal.ret_rms) for x in (rms.mean, rms.var)]
    import jax

    states = [getattr(model.policy, name, None) for name in ("actor_state", "qf_state", "vf_state")]
    kinds = ("params", "target_params", "batch_stats")
    trees = [getattr(state, kind, None) for state in states for kind in kinds]
    if hasattr(model, "ent_coef_state"):
        return jax.tree.leaves([*trees, model.ent_coef_state.params])
    mean, scale = model.normalisation
    return [*jax.tree.leaves(trees), mean, scale, model.statistics["returns"].var]


def seen_by(model, observations):
    """Observations as the library's own policy sees them."""
    if hasattr(model, "normalisation"):
        mean, scale = model.normalisation
        return (observations - mean) * scale
    normal = model.get_vec_normalize_env()
    return observations if normal is None else normal.normalize_obs(observations)


def test_a_distribution_over_the_parameters_in_another_order_is_refused():
    turned = Gaussian.prior(PRIOR.space.subset(PRIOR.space.names[::-1]))
    with pytest.raises(InvalidInput, match="the distribution to train on is over elbow_friction, "):
        train(ARM, VANILLA.source, turned, settings("sac"), stream("one"))


@pytest.mark.parametrize(
    ("algorithm", "given"),
    [
        ("sac", {"gamma": 0.9, "tau": 0.2, "gradient_steps": 3, "learning_starts": 50}),
        ("crossq", {"gamma": 0.9, "policy_delay": 5, "gradient_steps": 3, "learning_starts": 50}),
        ("ppo", {"gamma": 0.9, "gae_lambda": 0.8, "batch_size": 48, "clip_range": 0.3}),
        ("ppo", {"entropy_coefficient": 0.03, "epochs": 3}),
    ],
)
def test_every_setting_reaches_the_library(algorithm, given):
    env = RandomizedVecEnv(ARM, VANILLA.source, PRIOR, 12, np.random.default_rng(0))
    model = LIBRARIES[algorithm]["sb3"].build(env, ARM, settings(algorithm, **given), seed=1)
    names = {"entropy_coefficient": "ent_coef", "epochs": "n_epochs"}
    found = {name: getattr(model, names.get(name, name)) for name in given}
    assert {name: f(1.0) if callable(f) else f for name, f in found.items()} == given
    if algorithm == "sac":
        assert model.lr_schedule(1.0) == ARM.learning_rate  # by default the task's own
