"""Effects at contacts change a geom and the pairs that it is in, and no other."""

import numpy as np
import pytest

from adr_service.effects.base import Effect
from adr_service.effects.catalogue import get_mechanism

XML = """
<mujoco><worldbody>
<geom name="floor" type="plane" size="1 1 1"/>
<body name="ball"><freejoint/><geom name="skin" size=".1"/></body>
<body name="ghost"><freejoint/><geom name="air" size=".1" contype="0" conaffinity="0"/></body>
<body name="foot"><freejoint/><geom name="sole" size=".1" contype="0" conaffinity="0"/></body>
</worldbody>
<contact><pair geom1="sole" geom2="floor" friction="1 1 0.1 0.1 0.1"/></contact></mujoco>
"""


def test_only_geoms_that_can_touch_are_places(cart):
    places = get_mechanism("contact_friction").locations(cart(xml=XML))
    assert places == ["geom:skin", "geom:sole"]


def test_friction_changes_a_geom_or_its_pair_in_proportion(cart):
    model = cart(Effect("contact_friction", "geom:sole", (0.5,)), xml=XML)
    np.testing.assert_allclose(model.pair_friction[0], [1.5, 1.5, 0.1, 0.1, 0.1])
    assert model.geom("skin").friction[0] == 1.0


def test_a_stiffness_in_the_place_of_a_time_constant_is_left_alone(cart):
    """A geom may have one and its pair the other; the pair's is what acts."""
    stiff = XML.replace('0.1 0.1 0.1"/></contact>', '0.1 0.1 0.1" solref="-1000 -20"/></contact>')
    softer = Effect("contact_softness", "geom:sole", (0.5,))
    model = cart(softer, xml=stiff)
    assert model.pair_solref[0].tolist() == [-1000, -20]
    assert model.geom("sole").solref[0] == pytest.approx(0.03)
    own = XML.replace('name="sole"', 'name="sole" solref="-1000 -20"')
    model = cart(softer, xml=own)
    assert model.geom("sole").solref.tolist() == [-1000, -20]
    assert model.pair_solref[0, 0] == pytest.approx(0.03)
    both = stiff.replace('name="sole"', 'name="sole" solref="-1000 -20"')
    assert get_mechanism("contact_softness").locations(cart(xml=both)) == ["geom:skin"]


@pytest.mark.parametrize(
    ("kind", "field", "expected"),
    [("contact_margin", "margin", 0.5), ("contact_softness", "solref", 0.03)],
)
def test_margin_adds_and_softness_multiplies(cart, kind, field, expected):
    model = cart(Effect(kind, "geom:skin", (0.5,)), xml=XML)
    assert getattr(model.geom("skin"), field)[0] == pytest.approx(expected)


def test_a_margin_is_that_of_a_geoms_pairs_too(cart):
    model = cart(Effect("contact_margin", "geom:sole", (0.5,)), xml=XML)
    assert (model.pair_margin[0], model.geom("skin").margin[0]) == (0.5, 0.0)
