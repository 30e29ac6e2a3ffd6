"""Normal equations, against dense least squares."""

from dataclasses import replace

import numpy as np
import pytest

from adr_service.criticism.linear import (
    Linear,
    Normal,
    estimate,
    inverse,
    persistence_of,
    persisting,
)
from adr_service.criticism.noise import Chain, Noise, Whitener
from adr_service.criticism.variances import at_start

EPISODES, STEPS, WIDTH, COLUMNS = 6, 10, 2, 3


@pytest.fixture
def linear():
    """Residuals without noise of states, so that all of them are independent of variance one."""
    rng = np.random.default_rng(0)
    mask = np.ones((EPISODES, STEPS), dtype=bool)
    still = np.zeros((EPISODES, STEPS, WIDTH, WIDTH))
    chain = Chain(mask, still, ~mask, np.ones(WIDTH, bool), np.zeros(WIDTH))
    columns = rng.standard_normal((EPISODES, STEPS, WIDTH, COLUMNS))
    noise = rng.standard_normal((EPISODES, STEPS, WIDTH))
    residual = columns @ np.array([1.0, -2.0, 0.5]) + noise
    return Linear(chain, residual, columns, np.zeros(COLUMNS), np.zeros(COLUMNS))


def normal_of(linear):
    noise = Noise(np.ones(WIDTH), np.full((2, WIDTH), 1e-12), np.ones((EPISODES, STEPS)))
    return Normal.of(Whitener.of(linear.chain, noise), linear)


def dense(linear, episodes):
    """Ordinary least squares over some episodes."""
    rows = linear.columns[episodes].reshape(-1, linear.columns.shape[3])
    return np.linalg.lstsq(rows, linear.residual[episodes].ravel(), rcond=None)[0]


def test_the_most_probable_change_is_that_of_least_squares(linear):
    change, covariance = normal_of(linear).change()
    np.testing.assert_allclose(change, dense(linear, slice(None)), rtol=1e-6)
    rows = linear.columns.reshape(-1, COLUMNS)
    np.testing.assert_allclose(covariance, np.linalg.inv(rows.T @ rows), rtol=1e-6)


def test_an_episode_is_left_out_as_by_a_fit_to_the_others(linear):
    left = normal_of(linear).left_out()
    constant = WIDTH * STEPS * np.log(2 * np.pi) / 2
    for number in range(EPISODES):
        others = np.arange(EPISODES) != number
        rest = linear.residual[number] - linear.columns[number] @ dense(linear, others)
        weights = -4.0 / 2 * STEPS  # the prior of weights of one
        assert left[number] == pytest.approx(-np.sum(rest**2) / 2 - constant + weights, rel=1e-5)


def test_some_columns_of_all_are_the_same_as_these_alone(linear):
    alone = replace(
        linear, columns=linear.columns[..., [0, 2]], mean=np.zeros(2), precision=np.zeros(2)
    )
    some = normal_of(linear).only([0, 2])
    np.testing.assert_allclose(some.change()[0], normal_of(alone).change()[0], rtol=1e-9)
    np.testing.assert_allclose(some.left_out(), normal_of(alone).left_out(), rtol=1e-9)


def test_episodes_of_two_parts_are_those_of_the_whole(linear):
    whole = normal_of(linear)
    halves = [
        replace(
            whole,
            information=whole.information[part],
            score=whole.score[part],
            log_likelihood=whole.log_likelihood[part],
        )
        for part in (slice(0, 2), slice(2, None))
    ]
    np.testing.assert_array_equal(type(whole).joined(halves).left_out(), whole.left_out())


def test_a_strong_prior_keeps_a_column_where_it_was(linear):
    held = replace(linear, mean=np.array([7.0, 0, 0]), precision=np.array([1e9, 0, 0]))
    assert normal_of(held).change()[0][0] == pytest.approx(7.0, rel=1e-4)


def test_settling_all_columns_gains_at_least_as_much_as_some(linear):
    normal = normal_of(linear)
    assert (
        normal.best_log_likelihood()
        > normal.best_log_likelihood(slice(0, 1))
        > normal.log_likelihood.sum()
    )


def test_the_inverse_of_a_column_without_information_is_zero():
    information = np.diag([4.0, 0.0, 1e-12])
    np.testing.assert_allclose(inverse(information), np.diag([0.25, 0.0, 1e12]), rtol=1e-6)


def test_the_best_likelihood_does_not_depend_on_where_changes_are_counted_from(linear):
    """The prior stays where it is, so its mean moves by as much."""
    here = replace(linear, mean=np.array([1.0, -2.0, 0.5]), precision=np.array([3.0, 1.0, 2.0]))
    moved = np.array([0.3, 0.7, -0.4])
    there = replace(here, residual=here.residual - here.columns @ moved, mean=here.mean - moved)
    best = [normal_of(each).best_log_likelihood() for each in (here, there)]
    assert best[0] == pytest.approx(best[1], rel=1e-9)


def pushed(share):
    """A state that forces push about and a controller pulls back, and the state as a column: a
    spring that is not there. `share`: of a force that the next one keeps."""
    rng = np.random.default_rng(1)
    mask, still = np.ones((30, 80), dtype=bool), np.zeros((30, 80, 1, 1))
    state, force = np.zeros((30, 80)), np.zeros((30, 80))
    for k in range(80):
        before = force[:, k - 1] if k > 0 else rng.standard_normal(30)
        force[:, k] = share * before + np.sqrt(1 - share**2) * rng.standard_normal(30)
        if k > 0:
            state[:, k] = 0.8 * state[:, k - 1] + force[:, k - 1]
    chain = Chain(mask, still, ~mask, np.ones(1, bool), np.zeros(1))
    columns = state[..., None, None]
    return Linear(chain, force[..., None], columns, np.zeros(1), np.zeros(1))


KNOWN = np.ones(1, dtype=bool)


def settled(linear):
    start = at_start(linear.chain, linear.residual, np.array([1e-6]))
    return estimate(linear, start, KNOWN)[0]


@pytest.mark.parametrize("share", [0.0, 0.4, 0.7, 0.9])
def test_what_misfit_passes_on_is_found(share):
    linear = pushed(share)
    assert persistence_of(linear, settled(linear), KNOWN).share == share


def test_a_touch_does_not_hide_what_misfit_passes_on():
    """Its own misfit, a hundred times larger, is over with the transition."""
    linear, rng = pushed(0.7), np.random.default_rng(2)
    stiff = rng.random(linear.chain.mask.shape) < 0.05
    touched = linear.residual + 100 * stiff[..., None] * rng.standard_normal(linear.residual.shape)
    linear = replace(linear, chain=replace(linear.chain, stiff=stiff), residual=touched)
    assert persistence_of(linear, settled(linear), KNOWN).share == 0.7


def test_a_false_spring_gains_nothing_beside_misfit_that_persists():
    linear = pushed(0.7)
    persistence = persistence_of(linear, settled(linear), KNOWN)
    nothing = replace(
        linear, columns=linear.columns[..., :0], mean=np.empty(0), precision=np.empty(0)
    )
    gains = []
    for share in (0.0, persistence.share):
        with_spring, without = (
            persisting(each, share, [persistence.noise], KNOWN)[1].left_out().sum()
            for each in (linear, nothing)
        )
        gains.append(with_spring - without)
    assert gains[0] > 100
    assert abs(gains[1]) < 4


def test_the_covariance_between_episodes_is_corrected_for_their_number():
    """The sandwich, times 12 episodes over 12 less 2 columns."""
    rng = np.random.default_rng(0)
    x, y = rng.standard_normal((12, 30, 2)), rng.standard_normal((12, 30))
    information, score = x.swapaxes(1, 2) @ x, np.einsum("etp,et->ep", x, y)
    normal = Normal(information, score, np.zeros(12), np.zeros(2), np.zeros(2))
    bread = np.linalg.inv(information.sum(axis=0))
    apart = score - information @ bread @ score.sum(axis=0)
    expected = bread @ (apart.T @ apart) @ bread * 12 / 10
    np.testing.assert_allclose(normal.covariance(), expected, rtol=1e-6)


@pytest.mark.parametrize(
    ("episodes", "columns", "freedom"), [(30, 9, 21), (12, 9, 6), (8, 11, 4), (1, 1, 1)]
)
def test_a_few_episodes_leave_half_of_them_as_degrees_of_freedom(episodes, columns, freedom):
    nothing = np.zeros(columns)
    normal = Normal(
        np.zeros((episodes, columns, columns)),
        np.zeros((episodes, columns)),
        np.zeros(episodes),
        nothing,
        nothing,
    )
    assert normal.freedom == freedom
