"""Whitening, against dense algebra."""

from dataclasses import replace

import numpy as np
import pytest

from adr_service.criticism.noise import Chain, Factor, Noise, Whitener
from tests.chains import EXACT, MISFIT, SENSOR, STEPS, WIDTH, drawn, interrupted, remembered


def dense(chain, noise, episode, share=0.0):
    """One episode's covariance, written out, and how sensors' noise comes in, of all transitions
    that there are; with memory, of what is new in them."""
    there, count = chain.mask[episode], chain.mask.shape[1]
    passing = there & ~chain.stiff[episode]
    linked = passing & np.r_[False, passing[:-1]]
    mixing = np.kron(np.eye(count, count + 1, 1), np.eye(WIDTH))
    for k in range(count):
        own = slice(k * WIDTH, (k + 1) * WIDTH)
        mixing[own, own] = -chain.transition[episode, k]
    mixing = np.kron(np.eye(count) - share * np.diag(linked[1:], -1), np.eye(WIDTH)) @ mixing
    misfit = noise.misfit[chain.stiff[episode].astype(int)] / noise.weights[episode, :, None]
    misfit[~linked] /= 1 - share**2
    rows = np.repeat(there, WIDTH)
    mixing = mixing[rows]
    covariance = mixing @ np.diag(np.tile(noise.sensor, count + 1)) @ mixing.T
    return covariance + np.diag(misfit.ravel()[rows]), mixing


@pytest.mark.parametrize("episode", [0, 2, 3])
@pytest.mark.parametrize("share", [0.0, 0.6])
def test_an_episode_is_whitened_as_its_dense_covariance_says(episode, share):
    rng = np.random.default_rng(0)
    chain, residual = interrupted(*drawn(SENSOR, MISFIT, rng)[:2])
    noise = Noise(SENSOR, MISFIT, rng.uniform(0.2, 2.0, chain.mask.shape))
    covariance, mixing = dense(chain, noise, episode, share)
    there = chain.mask[episode]
    chain, residual = remembered(chain, residual, share)
    whitener = Whitener.of(chain, noise)
    white = whitener.whiten(residual[..., None])[..., 0]
    flat = residual[episode, there].ravel()
    expected = np.linalg.solve(np.linalg.cholesky(covariance), flat)
    np.testing.assert_allclose(white[episode, there].ravel(), expected, atol=1e-9)
    assert whitener.factor.log_determinant[episode] == pytest.approx(
        np.linalg.slogdet(covariance)[1]
    )
    errors, variance = whitener.sensor_errors(residual)
    blame = np.tile(SENSOR, STEPS + 1) * (mixing.T @ np.linalg.solve(covariance, flat))
    np.testing.assert_allclose(errors[episode].ravel(), blame, atol=1e-8)
    prior = np.diag(np.tile(SENSOR, STEPS + 1))
    posterior = prior - prior @ mixing.T @ np.linalg.solve(covariance, mixing @ prior)
    for state in range(STEPS + 1):
        block = slice(state * WIDTH, (state + 1) * WIDTH)
        np.testing.assert_allclose(variance[episode, state], posterior[block, block], atol=1e-8)


def test_what_is_left_out_in_the_middle_of_an_episode_says_nothing():
    chain, residual, _ = drawn(SENSOR, MISFIT, np.random.default_rng(4))
    noise = Noise(SENSOR, MISFIT, np.ones(chain.mask.shape))
    masked, left = interrupted(chain, residual)
    white = Whitener.of(masked, noise).whiten(left[..., None])[..., 0]
    assert not white[2, 7].any()
    for rows in (slice(0, 7), slice(8, STEPS)):  # each half as an episode of its own
        part = replace(
            chain,
            mask=chain.mask[2:3, rows],
            transition=chain.transition[2:3, rows],
            stiff=chain.stiff[2:3, rows],
        )
        own = Whitener.of(part, replace(noise, weights=noise.weights[2:3, rows]))
        alone = own.whiten(residual[2:3, rows, :, None])[..., 0]
        np.testing.assert_allclose(white[2, rows], alone[0], atol=1e-12)


def test_the_inverse_of_a_long_episode_is_exact_with_memory():
    """Rounding grew twofold with every transition where blocks were not kept symmetric."""
    count = 150
    mask = np.ones((1, count), dtype=bool)
    turned = np.broadcast_to([[1.0, 0.01], [-0.2, 0.99]], (1, count, WIDTH, WIDTH))
    chain = Chain(mask, turned, ~mask, np.ones(WIDTH, bool), EXACT).remembering(0.8)
    noise = Noise(np.array([1e-8, 4e-6]), np.full((2, WIDTH), 1e-10), np.ones(mask.shape))
    whitener = Whitener.of(chain, noise)
    unit = np.eye(count * WIDTH).reshape(1, count, WIDTH, -1)
    factor = whitener.whiten(unit)[0].reshape(count * WIDTH, -1)
    inverse = (factor.T @ factor).reshape(count, WIDTH, count, WIDTH)
    for lag, blocks in enumerate(whitener.inverse_blocks()):
        for k in range(lag, count):
            np.testing.assert_allclose(blocks[0, k], inverse[k, :, k - lag], rtol=1e-4, atol=1.0)


@pytest.mark.parametrize("share", [0.0, 0.6])
def test_some_episodes_are_whitened_as_among_all(share):
    chain, residual, _ = drawn(SENSOR, MISFIT, np.random.default_rng(8))
    chain, residual = remembered(chain, residual, share)
    whitener = Whitener.of(chain, Noise(SENSOR, MISFIT, np.ones(chain.mask.shape)))
    which = slice(2, 5)  # one of them is shorter
    part = whitener.of_episodes(which)
    white = whitener.whiten(residual[..., None])
    np.testing.assert_array_equal(part.whiten(residual[which, ..., None]), white[which])
    likely = whitener.log_likelihood(white[..., 0])[which]
    np.testing.assert_array_equal(part.log_likelihood(white[which, ..., 0]), likely)


def test_a_chain_is_factorised_once_under_each_of_the_latest_noises_that_are_kept(monkeypatch):
    chain, computed, factorise = drawn(SENSOR, MISFIT, np.random.default_rng(9))[0], [], Factor.of

    def counted(chain, noise):
        computed.append(noise.sensor[0])
        return factorise(chain, noise)

    monkeypatch.setattr(Factor, "of", counted)

    def whitener(size):
        return Whitener.of(chain, Noise(size * SENSOR, MISFIT, np.ones(chain.mask.shape)))

    first = whitener(1.0)
    first.keep()
    assert whitener(1.0).factor is first.factor  # of another noise that is equal
    whitener(2.0)
    whitener(2.0).keep()
    assert len(computed) == 3  # what was not kept is computed again
    for size in (3.0, 4.0, 5.0):
        whitener(size).keep()
    assert whitener(2.0).factor is whitener(2.0).factor
    assert whitener(1.0).factor is not first.factor
    assert whitener(2.0).chain.of_episodes(slice(0, 2)).factors == {}
