"""CrossQ's renormalisations in the layers behind them."""

import numpy as np

from adr_service.training.crossq import _renormalised


def test_layers_do_what_they_do_behind_their_renormalisations():
    """But for a column of observations that was constant in the whole training."""
    rng = np.random.default_rng(0)
    layers = [(rng.normal(size=(3, 3)), rng.normal(size=3)) for _ in range(2)]
    mean, factor, shift = rng.normal(size=(3, 2, 3))
    mean[:, 2], variance = 8.3, np.tile([0.5, 2.0, 1e-6], (2, 1))
    found = _renormalised(layers, list(zip(mean, variance, factor, shift, strict=True)))
    assert np.all(found[0][0][:, 2] == 0)
    assert np.all(found[1][0][:, 2] != 0)  # a neuron may come to life
    x = rng.normal(size=3)
    x[2] = 8.3
    for i, (weight, bias) in enumerate(found):
        scale = factor[i] / np.sqrt(variance[i] + 0.001)
        wanted = layers[i][0] @ ((x - mean[i]) * scale + shift[i]) + layers[i][1]
        np.testing.assert_allclose(weight @ x + bias, wanted, rtol=1e-4)
