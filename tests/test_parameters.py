"""Parameters and spaces: normalising, order, names and bounds."""

import pickle

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


def test_the_search_box_is_normalised_to_zero_to_four():
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


@given(st.lists(st.floats(-10, 10), min_size=2, max_size=2), st.floats(0, 1))
def test_normalising_is_affine(values, share):
    """The image of a mixture is the mixture of the images."""
    one, other = np.array(values), SPACE.high
    mixed = SPACE.normalise(share * one + (1 - share) * other)
    expected = share * SPACE.normalise(one) + (1 - share) * SPACE.normalise(other)
    np.testing.assert_allclose(mixed, expected, atol=1e-9)


def test_vectors_of_a_space_follow_the_order_of_its_parameters():
    assert SPACE.names == ("mass", "damping")
    assert (SPACE.low.tolist(), SPACE.high.tolist()) == ([0.5, 0.0], [10.0, 2.0])
    assert SPACE.feasible_low.tolist() == [0.1, 0.0]
    assert [SPACE.index(name) for name in SPACE.names] == [0, 1]
    assert not SPACE.low.flags.writeable


def test_values_within_a_hundredth_of_the_range_are_at_the_bound():
    assert SPACE.at_bound(SPACE.denormalise(np.array([0.03, 2.0]))) == ["mass"]
    assert SPACE.at_bound(SPACE.denormalise(np.array([0.05, 3.97]))) == ["damping"]
    assert SPACE.at_bound(SPACE.denormalise(np.array([-1.0, 5.0]))) == ["mass", "damping"]


def test_a_subset_has_the_given_order():
    assert SPACE.subset(("damping", "mass")).names == ("damping", "mass")
    assert len(SPACE.subset(())) == 0


def test_a_space_survives_pickling():
    assert pickle.loads(pickle.dumps(SPACE)) == SPACE  # noqa: S301 - our own bytes
