"""Normalisations in the layers behind them."""

import numpy as np

from adr_service.training.libraries import normalised, without_constants


def test_a_column_that_was_constant_in_training_is_ignored():
    rng = np.random.default_rng(0)
    seen = np.column_stack([rng.normal(2.0, 0.5, 200), np.full(200, 8.3)])
    mean, variance = seen.mean(axis=0), np.array([0.25, 1e-9])
    layer = (rng.normal(size=(4, 2)), rng.normal(size=4))
    scale = without_constants(1 / np.sqrt(variance), variance, np.full(2, 1e-8))
    weight, bias = normalised(layer, mean, scale)
    assert np.all(weight[:, 1] == 0)
    wanted = layer[0] @ ((seen - mean) / [0.5, 1]).T + layer[1][:, None]
    np.testing.assert_allclose(weight @ seen.T + bias[:, None], wanted, atol=1e-5)


def test_columns_that_varied_keep_every_bit_of_their_scale():
    scale = np.random.default_rng(0).normal(size=5).astype(np.float32)
    kept = without_constants(scale, np.full(5, 1e-9), np.zeros(5))
    assert kept.dtype == scale.dtype
    np.testing.assert_array_equal(kept, scale)
