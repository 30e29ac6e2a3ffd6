"""States at other times than they were read."""

import numpy as np

from adr_service.logs.base import Signal
from adr_service.logs.resampling import sampled
from adr_service.logs.tracks import Track


def test_a_derived_velocity_knows_nothing_from_beyond_a_gap():
    """A window with few readings takes the nearest ones of its own stretch."""
    before, after = np.arange(0.0, 1.0, 0.008), np.arange(1.5, 2.5, 0.008)
    time = np.concatenate([before, after])
    position = np.where(time < 1.2, 100.0, 3.0 * time)  # it was moved by hand meanwhile
    track = Track("q", "joint.position", Signal(time, position), is_fitted=True)
    centres = np.arange(1.51, 1.6, 0.02)
    values, slopes = sampled(track, centres, 0.02)
    np.testing.assert_allclose(values, 3.0 * centres)
    np.testing.assert_allclose(slopes, 3.0)
