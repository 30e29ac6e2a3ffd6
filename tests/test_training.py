import itertools
import json
import struct

import numpy as np
import pytest
from stable_baselines3.common.vec_env import VecMonitor

from adr_service.distributions import Gaussian, Uniform
from adr_service.errors import InvalidInput
from adr_service.progress import StageCancelled
from adr_service.randomness import stream
from adr_service.simulation.vec_env import RandomizedVecEnv
from adr_service.tasks.catalogue import get_task, variants_of
from adr_service.training.policy import Policy
from adr_service.training.sac import BACKENDS as BACKENDS_BY_NAME
from adr_service.training.sac import train
from adr_service.training.settings import TrainingSettings

ARM = get_task("arm")
VANILLA = variants_of(ARM.name)["vanilla"]
TRUTH = Uniform.point(VANILLA.source.space, VANILLA.hidden.values)
PRIOR = Gaussian.prior(VANILLA.source.space)
TINY = {
    "max_steps": 480,
    "hidden": [16, 16],
    "batch_size": 32,
    "evaluate_every": 240,
    "evaluation_episodes": 4,
}
BACKENDS = [
    "sb3",
    pytest.param("sbx", marks=pytest.mark.filterwarnings("ignore::DeprecationWarning")),
]


def policy(widths=(4, 8, 8, 2), activation="relu"):
    rng = np.random.default_rng(0)
    layers = tuple(
        (rng.normal(size=(b, a)).astype(np.float32), rng.normal(size=b).astype(np.float32))
        for a, b in itertools.pairwise(widths)
    )
    return Policy(layers, activation, np.array([-1.0, -2.0]), np.array([1.0, 4.0]))


class TestPolicy:
    @pytest.mark.parametrize("activation", ["relu", "tanh"])
    def test_bytes_give_the_same_policy_and_the_same_bytes_back(self, activation):
        original = policy(activation=activation)
        copy = Policy.from_bytes(original.to_bytes())
        observations = np.random.default_rng(1).normal(size=(6, 4))
        np.testing.assert_array_equal(copy.act(observations), original.act(observations))
        assert copy.to_bytes() == original.to_bytes()

    def test_actions_stay_within_their_bounds(self):
        actions = policy().act(100 * np.random.default_rng(1).normal(size=(1000, 4)))
        assert np.all((actions >= [-1, -2]) & (actions <= [1, 4]))
        assert actions.min(axis=0) == pytest.approx([-1, -2])

    @pytest.mark.parametrize(
        "content",
        [
            b"",
            b"nonsense",
            struct.pack("<Q", 2**40) + b"{}",
            struct.pack("<Q", 2) + b"{}",
            policy().to_bytes()[:-7],
        ],
        ids=["empty", "nonsense", "huge header", "no tensors", "truncated"],
    )
    def test_bytes_of_anything_else_are_refused(self, content):
        with pytest.raises(InvalidInput, match="not the bytes of a policy"):
            Policy.from_bytes(content)

    def test_layers_that_do_not_fit_are_refused(self):
        layers = policy().layers
        with pytest.raises(InvalidInput, match="do not fit"):
            Policy((layers[0], layers[0]), "relu", np.zeros(2), np.ones(2))

    def test_its_file_says_what_it_is_without_our_code(self):
        content = policy().to_bytes()
        (length,) = struct.unpack("<Q", content[:8])
        header = json.loads(content[8 : 8 + length])
        assert json.loads(header["__metadata__"]["policy"])["activation"] == "relu"
        assert header["layer_0.weight"] == {
            "dtype": "F32",
            "shape": [8, 4],
            "data_offsets": header["layer_0.weight"]["data_offsets"],
        }


class TestVecEnv:
    def env(self, distribution=PRIOR, n=4, seed=0):
        return RandomizedVecEnv(ARM, VANILLA.source, distribution, n, np.random.default_rng(seed))

    def test_new_dynamics_are_drawn_at_each_episodes_start_and_only_then(self):
        env = self.env()
        env.reset()
        before = env.dynamics
        ended = np.zeros(4, dtype=bool)
        for _ in range(60):
            _, _, done, infos = env.step(np.ones((4, 2)))
            changed = np.any(env.dynamics != before, axis=1)
            np.testing.assert_array_equal(changed, done)
            assert all(
                ("terminal_observation" in info) == d for info, d in zip(infos, done, strict=True)
            )
            before, ended = env.dynamics, ended | done
        assert ended.any()

    def test_an_episode_is_cut_at_the_horizon_and_says_so(self):
        env = self.env(TRUTH)
        env.reset()
        for _ in range(ARM.horizon):
            _, _, done, infos = env.step(np.zeros((4, 2)))
        assert done.all()
        assert all(info["TimeLimit.truncated"] for info in infos)

    def test_the_seed_decides_everything(self):
        rollouts = []
        for _ in range(2):
            env = self.env(seed=5)
            observations = [env.reset()]
            observations += [env.step(np.ones((4, 2)))[0] for _ in range(80)]
            rollouts.append(np.array(observations))
        np.testing.assert_array_equal(*rollouts)

    def test_draws_moved_onto_a_bound_are_counted(self):
        env = self.env(n=200)
        env.reset()
        assert env.adjusted > 0

    def test_sb3s_own_wrappers_work_on_it(self):
        env = VecMonitor(self.env(TRUTH))
        env.reset()
        for _ in range(ARM.horizon):
            *_, infos = env.step(np.zeros((4, 2)))
        assert infos[0]["episode"]["l"] == ARM.horizon


@pytest.mark.parametrize("backend", BACKENDS)
class TestSac:
    def train(self, backend, progress=lambda fraction, **facts: None, **changes):
        settings = TrainingSettings.model_validate({**TINY, "backend": backend, **changes})
        return train(ARM, VANILLA.source, PRIOR, settings, stream("test", 1), progress)

    def test_the_same_seed_gives_the_same_bytes(self, backend):
        first, second = self.train(backend), self.train(backend)
        assert first.policy.to_bytes() == second.policy.to_bytes()
        assert first.curve == second.curve

    def test_nothing_is_left_on_the_disk(self, backend, tmp_path, monkeypatch):
        monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
        self.train(backend)
        assert list(tmp_path.iterdir()) == []

    def test_the_policy_kept_is_the_best_evaluated(self, backend):
        training = self.train(backend)
        assert [point.steps for point in training.curve] == [240, 480]
        assert training.best.mean_return == max(p.mean_return for p in training.curve)

    def test_training_stops_at_the_threshold(self, backend):
        """The arm's first evaluation already earns something."""
        settings = TrainingSettings.model_validate({**TINY, "backend": backend})
        easy = type(ARM)(reward_threshold=0.1)
        training = train(easy, VANILLA.source, PRIOR, settings, stream("test", 1))
        assert training.steps == 240

    def test_the_policy_does_what_the_librarys_own_does(self, backend):
        """The weights are in the right layers: equal to float32's rounding."""
        settings = TrainingSettings.model_validate({**TINY, "backend": backend})
        env = RandomizedVecEnv(ARM, VANILLA.source, PRIOR, 4, np.random.default_rng(0))
        library = BACKENDS_BY_NAME[backend]
        model = library.build(env, settings, {"seed": 1, "learning_starts": 0, "batch_size": 16})
        model.learn(64)
        observations = np.random.default_rng(1).normal(size=(50, 4)).astype(np.float32)
        policy = library.policy(model, ARM, settings.activation)
        expected, _ = model.predict(observations, deterministic=True)
        np.testing.assert_allclose(policy.act(observations), expected, atol=2e-6)

    def test_it_can_be_cancelled_from_inside(self, backend):
        def stop(fraction, **facts):
            if fraction > 0.3:
                raise StageCancelled

        with pytest.raises(StageCancelled):
            self.train(backend, progress=stop)

    def test_numpys_global_generator_decides_nothing(self, backend):
        np.random.seed(1)  # noqa: NPY002
        first = self.train(backend)
        np.random.seed(2)  # noqa: NPY002
        assert first.policy.to_bytes() == self.train(backend).policy.to_bytes()
