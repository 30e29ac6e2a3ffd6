"""Neural posteriors of a linear problem with noise, whose posterior is known."""

import numpy as np
import pytest
import torch

from adr_service.randomness import stream
from adr_service.search.neural_posterior import FlowPosterior, MixturePosterior

NOISE = 0.05
SEEN = np.array([0.4, 0.7])
D = 2


def features(points, rng):
    """The points with noise: far from its bounds, their posterior is N(seen, NOISE^2)."""
    return points + NOISE * rng.normal(size=points.shape)


def learnt(kind, rounds=1, n=1000, epochs=1000):
    rng = stream("linear")
    posterior = (
        MixturePosterior(D, 2, epochs, rng) if kind == "mixture" else FlowPosterior(D, epochs, rng)
    )
    for number in range(rounds):
        points = rng.random((n, D)) if number == 0 else posterior.sample(n)
        seen = () if kind == "mixture" else (SEEN,)
        posterior.learn(points, features(points, rng), *seen)
    return posterior


@pytest.mark.slow
def test_a_mixture_is_the_posterior():
    """Tolerance: half of the noise in the mean, 30 % in the deviation."""
    weights, means, covariances = learnt("mixture", n=3000).mixture(SEEN)
    assert weights.sum() == pytest.approx(1)
    mean = weights @ means
    within = np.einsum("c,cij->ij", weights, covariances)
    between = np.einsum("c,ci,cj->ij", weights, means - mean, means - mean)
    np.testing.assert_allclose(mean, SEEN, atol=0.5 * NOISE)
    np.testing.assert_allclose(np.sqrt(np.diag(within + between)), NOISE, rtol=0.3)


@pytest.mark.slow
@pytest.mark.parametrize("rounds", [1, 2])
def test_samples_of_a_flow_are_those_of_the_posterior(rounds):
    """Tolerance: a fifth of the noise in the mean, 20 % in the deviation."""
    samples = learnt("flow", rounds, n=3000 // rounds).sample(2000)
    np.testing.assert_allclose(samples.mean(axis=0), SEEN, atol=0.2 * NOISE)
    np.testing.assert_allclose(samples.std(axis=0), NOISE, rtol=0.2)


def test_a_few_simulations_give_feasible_answers_that_repeat(tmp_path, monkeypatch, capsys):
    """No sample leaves the box, nothing is printed or written, and PyTorch's stream goes on."""
    monkeypatch.chdir(tmp_path)
    torch.manual_seed(3)
    before = torch.rand(1)
    torch.manual_seed(3)
    one = learnt("flow", 2, n=40, epochs=5).sample(50)
    assert torch.rand(1) == before
    other = learnt("flow", 2, n=40, epochs=5).sample(50)  # from another state of PyTorch's stream
    np.testing.assert_array_equal(one, other)
    assert np.all((one > 0) & (one < 1))
    mixtures = []
    for _ in range(2):
        mixtures.append(learnt("mixture", n=40, epochs=5).mixture(SEEN))
        torch.rand(1)
    for part, again in zip(*mixtures, strict=True):
        np.testing.assert_array_equal(part, again)
    assert capsys.readouterr() == ("", "")
    assert list(tmp_path.iterdir()) == []


def test_a_validation_with_fewer_than_ten_simulations_is_told_and_not_logged(caplog):
    """A tenth of 80 simulations is held out in the second round, of 120 in the third."""
    posterior = learnt("flow", 3, n=40, epochs=2)
    assert posterior.validation_atoms == 8
    assert caplog.records == []
    assert learnt("flow", 2, n=50, epochs=2).validation_atoms is None
    assert learnt("flow", 1, n=40, epochs=2).validation_atoms is None, (
        "the first round has no atoms"
    )
