"""The catalogue of mechanisms, whose order scans and reports keep."""

import pytest

from adr_service.effects.catalogue import MECHANISMS, get_mechanism
from adr_service.errors import UnknownName

KINDS = """
joint_coulomb_friction joint_viscous_friction joint_quadratic_friction
joint_asymmetric_viscous_friction joint_stribeck_friction joint_load_dependent_friction
joint_spring joint_cubic_spring joint_torque_ripple joint_position_dependent_friction
joint_reference_offset joint_armature joint_backlash
actuator_gain actuator_bias actuator_delay actuator_lag actuator_deadband actuator_saturation
actuator_fade
body_mass body_com body_inertia payload body_load gravity_compensation
gravity_tilt gravity_magnitude fluid_drag wind external_force
contact_friction contact_softness contact_margin
sensor_bias sensor_scale joint_encoder_scale sensor_delay sensor_quantisation sensor_noise
"""


def test_the_order_of_kinds_never_changes():
    """Candidates with equal evidence keep it."""
    assert list(MECHANISMS) == KINDS.split()


def test_a_mechanism_is_known_by_its_kind():
    assert all(get_mechanism(kind).kind == kind for kind in MECHANISMS)


def test_an_unknown_kind_is_refused_with_the_nearest_one():
    with pytest.raises(UnknownName, match=r"there is no mechanism 'joint_sprang'.*'joint_spring'"):
        get_mechanism("joint_sprang")
