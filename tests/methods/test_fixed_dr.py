"""Domain randomization over the whole box: a curriculum that stays."""

import numpy as np

from adr_service.methods.fixed_dr import FixedDrSettings
from tests.planted import PROBLEM, SPACE


def test_the_whole_box_is_drawn_from_whatever_the_returns_are():
    curriculum = FixedDrSettings().create(PROBLEM)
    for earned in (0.0, 1e6):
        values = curriculum.sample(4000, np.random.default_rng(0)).values
        share = (values - SPACE.low) / (SPACE.high - SPACE.low)
        assert share.min() < 0.01
        assert share.max() > 0.99
        np.testing.assert_allclose(share.mean(axis=0), 0.5, atol=0.02)
        curriculum.move(values, np.full(4000, earned))
