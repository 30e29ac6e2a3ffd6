"""Effects at joints do what their formulas say."""

import mujoco
import numpy as np
import pytest

from adr_service.criticism.extension import extend
from adr_service.effects.base import Effect, Motion
from adr_service.effects.catalogue import MECHANISMS
from adr_service.effects.joints import BACKLASH
from adr_service.effects.models import with_effects


@pytest.mark.parametrize("default", ["", 'gear="50" dyntype="integrator" forcerange="-1 1"'])
@pytest.mark.parametrize("damping", [4.0, -4.0])
def test_a_brake_acts_one_way_whatever_the_defaults_are(moving, default, damping):
    """v(t) = v exp(-|d| t / m) for one sign of v; implicit Euler to first order."""
    slide = moving(default)
    effect = Effect("joint_asymmetric_viscous_friction", "joint:x", (damping,))
    after = slide.predict(np.empty(0), [effect], slide.measured)[:, 1]
    before = slide.measured[slide.starts, 1]
    braked = np.sign(before) == np.sign(damping)
    np.testing.assert_array_equal(after[~braked], before[~braked])
    np.testing.assert_allclose(after[braked], before[braked] * np.exp(-0.002 * 4 / 2), rtol=1e-4)


@pytest.mark.parametrize(
    ("kind", "location", "values"),
    [
        ("joint_asymmetric_viscous_friction", "joint:x", (0.0,)),
        ("joint_stribeck_friction", "joint:x", (0.0, 0.0)),
        ("joint_torque_ripple", "joint:x", (0.0, 0.0, 3.0)),
        ("external_force", "body:cart", (0.0, 0.0, 0.0)),
    ],
)
def test_an_added_actuator_has_nothing_of_the_defaults(moving, kind, location, values):
    slide = moving('damping="1" armature="0.1"')
    without = slide.predict(np.empty(0), [], slide.measured)
    with_zero = slide.predict(np.empty(0), [Effect(kind, location, values)], slide.measured)
    np.testing.assert_array_equal(with_zero, without)


@pytest.mark.parametrize(
    ("kind", "present", "added", "together"),
    [
        ("joint_asymmetric_viscous_friction", (4.0,), (0.5,), [(4.5,)]),
        ("joint_asymmetric_viscous_friction", (-4.0,), (-0.5,), [(-4.5,)]),
        # forwards 4 and backwards .5: damping of .5, and a brake of 3.5
        ("joint_asymmetric_viscous_friction", (4.0,), (-0.5,), [(3.5,), 0.5]),
        ("joint_stribeck_friction", (1.0, 0.5), (0.2, 0.1), [(1.2, 0.6)]),
        ("joint_torque_ripple", (1.0, 0.5, 3.0), (0.2, 0.1, 3.0), [(1.2, 0.6, 3.0)]),
    ],
)
def test_an_effect_is_added_to_what_an_extended_model_has(moving, kind, present, added, together):
    slide, location = moving(), "joint:x"
    extended = extend(slide.nominal, np.empty(0), [Effect(kind, location, present)]).nominal()
    again = type(slide)(extended, slide.data, threads=1)
    once_more = again.predict(np.empty(0), [Effect(kind, location, added)], again.measured)
    whole, *damping = together
    at_once = [Effect(kind, location, whole)]
    at_once += [Effect("joint_viscous_friction", location, (value,)) for value in damping]
    expected = slide.predict(np.empty(0), at_once, slide.measured)
    np.testing.assert_allclose(once_more, expected, rtol=1e-9, atol=1e-12)
    assert np.abs(expected - slide.predict(np.empty(0), [], slide.measured)).max() > 1e-4


def test_no_effect_is_an_actuator_of_a_joint_whose_actuators_are_limited_together():
    limited = '<joint name="x" type="slide" actuatorfrcrange="-1 1"/>'
    model = mujoco.MjModel.from_xml_string(
        f'<mujoco><worldbody><body name="cart">{limited}<geom size="0.1" mass="2"/></body>'
        "</worldbody></mujoco>"
    )
    kinds = ("joint_asymmetric_viscous_friction", "joint_stribeck_friction", "external_force")
    assert [MECHANISMS[kind].locations(model) for kind in kinds] == [[], [], []]
    assert MECHANISMS["joint_viscous_friction"].locations(model) == ["joint:x"]


HINGES = """
<mujoco><worldbody><body name="link"><joint name="free" axis="0 1 0"/><geom size=".1" mass="2"/>
<body><joint name="driven" axis="0 1 0"/><geom size=".1" mass="2"/>
<body><joint name="limited" axis="0 1 0" actuatorfrcrange="-1 1"/><geom size=".1" mass="2"/>
<body><joint name="slide" type="slide" axis="0 1 0"/><geom size=".1" mass="2"/></body>
</body></body></body></worldbody>
<actuator><motor joint="driven"/><motor joint="limited"/><motor joint="slide"/></actuator></mujoco>
"""


def test_torque_ripples_with_the_angle_of_a_driven_hinge(cart):
    """sine sin(n q) + cosine cos(n q), whatever else acts there."""
    effects = [Effect("joint_torque_ripple", "joint:driven", (0.3, -0.2, 7.5))]
    model = cart(*effects, xml=HINGES)
    data = mujoco.MjData(model)
    for angle in (-2.0, 0.0, 0.1, 3.0):
        data.qpos[1], data.qvel[1] = angle, 5.0
        mujoco.mj_forward(model, data)
        expected = 0.3 * np.sin(7.5 * angle) - 0.2 * np.cos(7.5 * angle)
        assert data.qfrc_actuator[1] == pytest.approx(expected)
    ripple = MECHANISMS["joint_torque_ripple"]
    assert ripple.locations(cart(xml=HINGES)) == ["joint:driven"]


def test_a_ripple_is_beside_another_that_an_extended_model_has(cart):
    first = Effect("joint_torque_ripple", "joint:driven", (0.3, -0.2, 7.5))
    second = Effect("joint_torque_ripple", "joint:driven", (0.1, 0.0, 2.0))
    spec = mujoco.MjSpec.from_string(HINGES)
    spec.copy_back(with_effects(spec, lambda model: None, [first]))
    model = cart(second, xml=spec.to_xml())
    data = mujoco.MjData(model)
    data.qpos[1] = 0.4
    mujoco.mj_forward(model, data)
    expected = 0.3 * np.sin(3.0) - 0.2 * np.cos(3.0) + 0.1 * np.sin(0.8)
    assert data.qfrc_actuator[1] == pytest.approx(expected)


def test_viscous_friction_brakes_both_ways(moving):
    slide = moving()
    effect = Effect("joint_viscous_friction", "joint:x", (4.0,))
    after = slide.predict(np.empty(0), [effect], slide.measured)[:, 1]
    before = slide.measured[slide.starts, 1]
    np.testing.assert_allclose(after, before * np.exp(-0.002 * 4 / 2), rtol=1e-4)


def test_quadratic_friction_brakes_both_ways_with_the_square_of_speed(cart):
    model = cart(Effect("joint_quadratic_friction", "joint:x", (4.0,)))
    data = mujoco.MjData(model)
    for speed, force in ((1.0, -4.0), (-1.0, 4.0), (0.5, -1.0)):
        data.qvel[0] = speed
        mujoco.mj_forward(model, data)
        assert data.qfrc_passive[0] == pytest.approx(force)


def test_a_cubic_spring_pulls_with_the_cube_of_the_displacement(cart):
    model = cart(Effect("joint_cubic_spring", "joint:x", (8.0,)))
    data = mujoco.MjData(model)
    for position, force in ((0.5, -1.0), (-0.5, 1.0), (1.0, -8.0)):
        data.qpos[0] = position
        mujoco.mj_forward(model, data)
        assert data.qfrc_passive[0] == pytest.approx(force)


def test_stribeck_friction_is_smaller_at_speed_than_coulomb_friction(moving):
    slide = moving()
    coulomb, stribeck = (
        slide.predict(np.empty(0), [effect], slide.measured)[:, 1]
        for effect in (
            Effect("joint_coulomb_friction", "joint:x", (5.0,)),
            Effect("joint_stribeck_friction", "joint:x", (5.0, 2.0)),
        )
    )
    before = np.abs(slide.measured[slide.starts, 1])
    assert np.all(before - np.abs(stribeck) < before - np.abs(coulomb))
    np.testing.assert_array_less(np.abs(stribeck), before)


@pytest.mark.parametrize(("speed", "left"), [(1.0, 3.0), (-2.0, -1.0), (4.0, 0.0)])
def test_stribeck_friction_falls_with_speed_to_nothing(cart, speed, left):
    """5 N at rest, less by 2 N for each m/s, on 2 kg."""
    model = cart(Effect("joint_stribeck_friction", "joint:x", (5.0, 2.0)))
    data = mujoco.MjData(model)
    data.qvel[0] = speed
    mujoco.mj_forward(model, data)
    assert data.qacc[0] == pytest.approx(-left / 2.0, abs=1e-6)


def test_an_extended_model_can_be_criticised_again_and_a_zero_still_is_nothing(moving):
    slide = moving()
    effects = [
        Effect("joint_asymmetric_viscous_friction", "joint:x", (4.0,)),
        Effect("external_force", "body:cart", (1.0, 0.0, 0.0)),
    ]
    extended = extend(slide.nominal, np.empty(0), effects).nominal()
    again = type(slide)(extended, slide.data, threads=1)
    assert not [p for m in MECHANISMS.values() for p in m.locations(again.base) if "adr_" in p]
    without = again.predict(np.empty(0), [], again.measured)
    for effect in effects:
        nothing = Effect(effect.kind, effect.location, (0.0,) * len(effect.values))
        np.testing.assert_array_equal(
            again.predict(np.empty(0), [nothing], again.measured), without
        )


def test_backlash_follows_only_the_edge_that_pushes():
    positions = np.array([[0.0, 0.3, 1.0, 0.9, 0.4, -1.0]])
    shown = BACKLASH.sensing.record(positions, np.array([0.4]), 0.01)
    np.testing.assert_allclose(shown, [[0.0, 0.1, 0.8, 0.8, 0.6, -0.8]])
    np.testing.assert_array_less(np.abs(shown - positions), 0.2 + 1e-12)


def test_the_offset_of_backlash_is_what_a_whole_record_shows():
    """Once the joint has moved through the gap, whatever it was before."""
    rows = 0.1 * np.arange(100)
    truth, values = np.sin(rows), np.array([0.4])
    before = np.maximum(np.arange(100)[:, None] - np.arange(1, 33), 0)
    motion = Motion(truth[:, None], truth[:, None], 0, past=truth[:, None] - truth[before])
    expected = BACKLASH.sensing.record(truth[None], values, 0.1)[0] - truth
    np.testing.assert_allclose(BACKLASH.sensing.offset(motion, values), expected, atol=1e-12)


def test_an_offset_of_the_reference_moves_the_body_forwards(cart):
    places = []
    for effects in ([], [Effect("joint_reference_offset", "joint:x", (0.1,))]):
        model = cart(*effects)
        data = mujoco.MjData(model)
        data.qpos[0] = 0.2
        mujoco.mj_forward(model, data)
        places.append(data.body("cart").xpos[0])
    np.testing.assert_allclose(places, [0.2, 0.3])


def test_armature_is_added_to_the_mass_that_a_drive_accelerates(cart):
    for armature in (0.0, 0.5):
        model = cart(Effect("joint_armature", "joint:x", (armature,)))
        data = mujoco.MjData(model)
        data.ctrl[0] = 1.0
        mujoco.mj_forward(model, data)
        assert data.qacc[0] == pytest.approx(3.0 / (2.0 + armature), rel=1e-9)
