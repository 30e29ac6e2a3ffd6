import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from adr_service.errors import InvalidInput, UnknownName
from adr_service.parameters import Parameter, ParameterSpace

SPACE = ParameterSpace(
    (
        Parameter("mass", "body:torso.mass", "kg", 0.5, 10.0, 0.1),
        Parameter("damping", "joint:hip.damping", "N m s/rad", 0.0, 2.0, 0.0),
    )
)


@given(st.lists(st.floats(-10, 10), min_size=2, max_size=2))
def test_normalising_is_undone_by_denormalising(values):
    np.testing.assert_allclose(
        SPACE.denormalise(SPACE.normalise(np.array(values))), values, atol=1e-12
    )


def test_the_search_box_is_zero_to_four():
    np.testing.assert_array_equal(SPACE.normalise(SPACE.low), [0, 0])
    np.testing.assert_array_equal(SPACE.normalise(SPACE.high), [4, 4])


def test_an_unknown_name_is_answered_with_the_nearest_and_the_list():
    with pytest.raises(UnknownName, match=r"did you mean 'mass'\?.*mass, damping"):
        SPACE.index("mas")


@pytest.mark.parametrize(
    "bounds", [(1, 1, 0), (2, 1, 0), (0, 1, 0.5), (0, np.inf, 0), (np.nan, 1, 0)]
)
def test_a_parameter_without_a_proper_interval_is_refused(bounds):
    with pytest.raises(InvalidInput, match="feasible_low <= low < high"):
        Parameter("mass", "body:torso.mass", "kg", *bounds)


def test_repeated_names_are_refused():
    with pytest.raises(InvalidInput, match="unique"):
        ParameterSpace((SPACE.parameters[0], SPACE.parameters[0]))
