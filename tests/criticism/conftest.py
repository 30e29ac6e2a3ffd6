"""Measurements that the tests of criticism share."""

import numpy as np
import pytest

from benchmarks.planted import draw_case, hide
from tests.hidden import arm, recorded


@pytest.fixture(scope="session")
def good():
    """The arrays of a measurement of an arm with nothing wrong."""
    return recorded(draw_case(*arm(), np.random.default_rng(1), 0.3, count=0).measurement)


@pytest.fixture(scope="session")
def clean():
    """The arrays of an arm without any effect; noise of 1 mrad and 10 mrad/s."""
    task, nominal = arm()
    return recorded(hide(task, nominal, np.random.default_rng(403), []).episodes(range(12)))
