"""The trust region's linear model is exact where it should be, and its search finds the optimum."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from scipy.optimize import approx_fprime
from scipy.stats import norm, qmc

from adr_service.errors import InvalidInput
from adr_service.methods.dropo import log_likelihood
from adr_service.progress import silent
from adr_service.search.trust_region import (
    Bounds,
    CorrectedModel,
    Evaluation,
    Linearisation,
    TrustRegion,
)

EPSILON = 0.01
RNG = np.random.default_rng(0)
SLOPES = RNG.normal(size=(12, 3, 2))  # (w, s, d)
TRUTH, SPREAD = np.array([0.7, -0.4]), np.array([0.3, 0.05])
DRAWN = TRUTH + SPREAD * RNG.normal(size=(12, 2))  # each window's own parameters
MEASURED = np.einsum("wsd,wd->ws", SLOPES, DRAWN) + RNG.normal(0, EPSILON**0.5, (12, 3))
HALF = norm.ppf(qmc.LatinHypercube(2, rng=RNG).random(20))
LEVELS = np.concatenate([HALF, -HALF])  # so that their mean is zero
BOUNDS = Bounds(np.full(2, -2.0), np.full(2, 2.0), np.full(2, 1e-5), np.full(2, 1.0))


def linear(draws):
    return np.einsum("wsd,kd->kws", SLOPES, draws)


def bent(draws):
    return linear(draws + 0.2 * draws**2)


def evaluation(simulate, levels=LEVELS):
    """The loss of Gaussians by a simulator, and the number of Gaussians so far."""

    def evaluate(mean, std):
        evaluate.count += 1
        draws = mean + std * levels
        predictions = simulate(draws)
        broken = not np.all(np.isfinite(predictions))
        loss = np.inf if broken else -log_likelihood(predictions, MEASURED, EPSILON)
        return Evaluation(mean, std, loss, draws, predictions)

    evaluate.count = 0
    return evaluate


def found(simulate=linear, budget=100, bounds=BOUNDS, std=1.0):
    evaluate = evaluation(simulate)
    search = TrustRegion(evaluate, MEASURED, EPSILON, bounds)
    best, path = search.minimise(np.zeros(2), np.full(2, std), budget=budget, progress=silent)
    assert len(path.steps) <= evaluate.count <= budget
    return best, path


@pytest.mark.parametrize("simulate", [linear, bent])
def test_the_models_loss_is_the_simulated_one_where_it_was_made(simulate):
    at = evaluation(simulate)(TRUTH, SPREAD)
    model = Linearisation.around(at, MEASURED, EPSILON)
    assert model.loss(np.zeros(4))[0] == pytest.approx(at.loss, rel=1e-9)


@pytest.mark.parametrize("levels", [LEVELS, np.abs(LEVELS)])
def test_the_model_of_a_linear_simulator_is_exact_everywhere(levels):
    """Also where the draws are all on one side of the mean, as a feasible bound leaves them."""
    evaluate = evaluation(linear, levels)
    model = Linearisation.around(evaluate(np.zeros(2), np.ones(2)), MEASURED, EPSILON)
    shift, growth = np.array([0.6, -0.5]), np.array([-1.0, 0.4])
    moved = evaluate(shift, np.exp(growth))
    assert model.loss(np.concatenate([shift, growth]))[0] == pytest.approx(moved.loss, rel=1e-9)


@pytest.mark.parametrize("levels", [LEVELS, np.abs(LEVELS)])
def test_the_models_gradient_is_that_of_finite_differences(levels):
    at = evaluation(bent, levels)(TRUTH, 2 * SPREAD)
    model = Linearisation.around(at, MEASURED, EPSILON)
    move = np.array([0.3, -0.2, 0.5, -0.4])
    numerical = approx_fprime(move, lambda x: model.loss(x)[0], 1e-7)
    np.testing.assert_allclose(model.loss(move)[1], numerical, rtol=1e-4, atol=1e-4)


def test_a_bonus_on_entropy_is_in_the_models_loss_and_its_gradient():
    at, move = evaluation(bent)(TRUTH, 2 * SPREAD), np.array([0.3, -0.2, 0.5, -0.4])
    plain, bonus = (Linearisation.around(at, MEASURED, EPSILON, e).loss(move) for e in (0.0, 3.0))
    assert plain[0] - bonus[0] == pytest.approx(3.0 * 0.1)
    np.testing.assert_allclose(plain[1] - bonus[1], [0, 0, 3, 3])


def test_a_corrected_model_has_the_loss_of_every_move_that_failed():
    at = evaluation(bent)(TRUTH, 2 * SPREAD)
    model = CorrectedModel(Linearisation.around(at, MEASURED, EPSILON))
    moves = [np.array([0.3, -0.2, 0.5, -0.4]), np.array([-0.1, 0.6, 0.0, 0.2])]
    for move, rise in zip(moves, (7.0, 2.0), strict=True):
        model = model.corrected(move, rise)
    losses = [model.loss(move)[0] - model.loss(np.zeros(4))[0] for move in moves]
    np.testing.assert_allclose(losses, [7.0, 2.0], rtol=1e-6)
    numerical = approx_fprime(moves[0], lambda x: model.loss(x)[0], 1e-7)
    np.testing.assert_allclose(model.loss(moves[0])[1], numerical, rtol=1e-4, atol=1e-4)


def test_a_move_that_diverged_corrects_nothing():
    at = evaluation(bent)(TRUTH, 2 * SPREAD)
    model = CorrectedModel(Linearisation.around(at, MEASURED, EPSILON))
    assert model.corrected(np.ones(4), np.inf) is model


def test_a_search_has_not_converged_if_only_a_correction_sees_no_way_down():
    """Beside a cliff, a step that fell corrects the model, which then likes no step at all."""
    evaluate = evaluation(linear)

    def beside_a_cliff(mean, std):
        at = evaluate(mean, std)
        return replace(at, loss=at.loss + 50 * bool(np.abs(mean).max() > 0.4))

    search = TrustRegion(beside_a_cliff, MEASURED, EPSILON, BOUNDS)
    best, path = search.minimise(np.zeros(2), np.ones(2), budget=100, progress=silent)
    assert path.stopped_by == "rough"
    assert best.loss < path.steps[0].loss - 1


def test_draws_that_have_collapsed_do_not_slow_the_mean():
    """It has 70,000 of their deviations to go."""
    collapsed = Bounds(np.full(2, -2.0), np.full(2, 2.0), np.full(2, 1e-5), np.full(2, 2e-5))
    best, path = found(bounds=collapsed, std=1e-5)
    assert path.stopped_by == "converged"
    assert len(path.steps) < 30
    np.testing.assert_allclose(best.mean, TRUTH, atol=0.3)


def test_the_search_ends_where_the_likelihood_has_no_slope():
    best, path = found(bent)
    assert path.stopped_by == "converged"
    assert len(path.steps) < 15
    evaluate = evaluation(bent)

    def loss(x):
        return evaluate(x[:2], np.exp(x[2:])).loss

    slope = approx_fprime(np.concatenate([best.mean, np.log(best.std)]), loss, 1e-6)
    np.testing.assert_allclose(slope, 0, atol=0.5)


def test_a_planted_spread_is_recovered():
    """The means within three standard errors, the deviation that matters within a half."""
    best, _ = found()
    np.testing.assert_allclose(best.mean, TRUTH, atol=3 * 0.3 / 12**0.5)
    assert best.std[0] == pytest.approx(0.3, rel=0.5)


def test_the_best_is_the_least_loss_that_was_simulated():
    best, path = found(bent)
    assert best.loss == min(step.loss for step in path.steps)


def test_a_search_improves_where_the_simulator_has_kinks():
    """A step that is a loss corrects the model, so that the next one is elsewhere or shorter.

    Without corrections this search ends at a loss of 4.16, with them at 3.76.
    """

    def kinked(draws):
        return linear(draws) + 0.5 * np.abs(np.sin(5 * draws[:, :1, None]))

    best, path = found(kinked)
    assert path.steps[0].predicted_loss is None
    losses = [step.loss for step in path.steps]
    assert any(loss > previous for previous, loss in pairwise(losses))
    for i, (step, following) in enumerate(pairwise(path.steps)):
        if i > 0 and step.loss > min(losses[:i]):
            assert following.radius <= step.radius / 2
    assert best.loss < min(4.0, losses[0] - 10)


def test_the_search_stays_in_its_bounds():
    narrow = Bounds(np.full(2, -0.1), np.full(2, 0.1), np.full(2, 0.2), np.full(2, 0.5))
    best, _ = found(bounds=narrow, std=0.5)
    assert np.all(np.abs(best.mean) <= 0.1)
    assert np.all((best.std >= 0.2) & (best.std <= 0.5))
    assert best.mean[0] == 0.1  # the truth lies beyond


def test_a_search_ends_with_its_budget():
    _, path = found(bent, budget=2)
    assert path.stopped_by == "budget"
    assert len(path.steps) == 2


def test_a_start_that_diverges_is_narrowed():
    def fragile(draws):
        return np.where(np.abs(draws).max() > 1, np.nan, linear(draws))

    best, _ = found(fragile)
    assert np.isfinite(best.loss)


def test_a_start_that_diverges_however_narrow_is_an_error():
    with pytest.raises(InvalidInput, match=r"down to \[0.25, 0.25\]"):
        found(lambda draws: linear(draws) * np.nan, budget=2)
    with pytest.raises(InvalidInput, match="diverged for draws around"):
        found(lambda draws: np.full((len(draws), 12, 3), np.nan))
