"""Trainings by both backends: repeatable, cancellable, and stopped at the threshold."""

import numpy as np
import pytest

from adr_service.distributions import Gaussian, Uniform
from adr_service.progress import StageCancelled
from adr_service.randomness import stream
from adr_service.simulation.vec_env import RandomizedVecEnv
from adr_service.tasks.catalogue import get_task, variants_of
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


@pytest.mark.parametrize("backend", BACKENDS)
class TestSac:
    def train(self, backend, progress=lambda fraction, **facts: None, **changes):
        settings = TrainingSettings.model_validate({**TINY, "backend": backend, **changes})
        return train(ARM, VANILLA.source, PRIOR, settings, stream("test", 1), progress)

    def test_the_same_seed_gives_the_same_bytes(self, backend):
        first, second = self.train(backend), self.train(backend)
        assert first.policy.to_bytes() == second.policy.to_bytes()
        assert first.curve == second.curve

    def test_a_training_leaves_no_file(self, backend, tmp_path, monkeypatch):
        monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
        self.train(backend)
        assert list(tmp_path.iterdir()) == []

    def test_the_best_evaluated_policy_is_kept(self, backend):
        training = self.train(backend)
        assert [point.steps for point in training.curve] == [240, 480]
        assert training.best.mean_return == max(p.mean_return for p in training.curve)

    def test_training_stops_at_the_threshold(self, backend):
        """The arm's first evaluation already earns something."""
        settings = TrainingSettings.model_validate({**TINY, "backend": backend})
        easy = type(ARM)(reward_threshold=0.1)
        training = train(easy, VANILLA.source, PRIOR, settings, stream("test", 1))
        assert training.steps == 240

    def test_the_policy_acts_as_the_librarys_own(self, backend):
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

    def test_a_training_stops_when_its_progress_raises_a_cancellation(self, backend):
        def stop(fraction, **facts):
            if fraction > 0.3:
                raise StageCancelled

        with pytest.raises(StageCancelled):
            self.train(backend, progress=stop)

    def test_the_state_of_numpys_global_generator_changes_nothing(self, backend):
        np.random.seed(1)  # noqa: NPY002
        first = self.train(backend)
        np.random.seed(2)  # noqa: NPY002
        assert first.policy.to_bytes() == self.train(backend).policy.to_bytes()
