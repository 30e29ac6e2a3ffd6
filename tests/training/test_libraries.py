"""Normalisations in the layers behind them."""

import numpy as np

from adr_service.training.libraries import normalised, of_what_varied


def test_a_column_that_was_constant_in_training_has_no_say_on_the_target():
    """As Humanoid's masses, which the unmodeled variant freezes, and the target has otherwise."""
    rng = np.random.default_rng(0)
    seen = np.column_stack([rng.normal(2.0, 0.5, 200), np.full(200, 8.3), np.zeros(200)])
    mean, variance = seen.mean(axis=0), seen.var(axis=0) + np.array([0.0, 1e-6, 0.0])  # of rounding
    layer = (rng.normal(size=(4, 3)), rng.normal(size=4))
    weight, bias = normalised(
        layer, mean, of_what_varied(1 / np.sqrt(variance + 1e-12), mean, variance)
    )
    assert np.all(weight[:, 1:] == 0)
    wanted = layer[0] @ ((seen - mean) / [seen[:, 0].std(), 1, 1]).T + layer[1][:, None]
    np.testing.assert_allclose(weight @ seen.T + bias[:, None], wanted, atol=1e-5)


def test_columns_that_varied_keep_every_bit_of_their_scale():
    scale = np.random.default_rng(0).normal(size=5).astype(np.float32)
    kept = of_what_varied(scale, np.zeros(5), np.full(5, 1e-9))
    assert kept.dtype == scale.dtype
    np.testing.assert_array_equal(kept, scale)
