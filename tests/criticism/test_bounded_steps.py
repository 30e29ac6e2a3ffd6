"""Steps of parameters to their bounds, and shorter ones."""

import numpy as np
import pytest

from adr_service.criticism.bounded_steps import limited, moved, shorter
from adr_service.parameters import Parameter, ParameterSpace


@pytest.mark.parametrize("low", [0.0, 0.05])
@pytest.mark.parametrize("seed", range(20))
def test_a_step_beyond_a_bound_ends_there_to_the_last_bit(low, seed):
    """A parameter that rounding left just before it would not be held."""
    start, high = np.sort(np.random.default_rng(seed).uniform(0.05, 3.0, 2))
    space = ParameterSpace((Parameter("x", "joint:x.damping", "", low, high, low),))
    for step, end in ((100.0, high), (-100.0, low)):
        values = np.array([start])
        for _ in range(5):  # by a factor of e² at most
            within = limited(space, values, np.array([step, 7.0]))
            assert within[1] == 7.0
            values = moved(space, values, within)
        assert values[0] == end


def test_a_positive_parameter_moves_in_proportion_and_others_by_sums():
    bounds = ((0.1, 0.1), (0.0, 0.0))
    space = ParameterSpace(
        tuple(Parameter(f"x{low}", f"joint:x{low}.damping", "", low, 9.0, f) for low, f in bounds)
    )
    after = moved(space, np.array([2.0, 2.0]), np.array([1.0, 1.0]))
    np.testing.assert_allclose(after, [2 * np.exp(0.5), 3.0])


def test_a_refused_step_is_shortened_as_a_whole_and_then_halved():
    step, within = np.array([10.0, -40.0, 3.0]), np.array([5.0, -2.0, 3.0])
    short = shorter(step, within)
    np.testing.assert_allclose(short, step / 20)
    np.testing.assert_allclose(shorter(short, short * (1 - 1e-12)), step / 40)
    np.testing.assert_allclose(shorter(step, np.array([0.0, -40.0, 3.0])), step / 2)
