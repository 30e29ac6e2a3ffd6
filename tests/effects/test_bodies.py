"""Effects in bodies obey mechanics."""

import mujoco
import numpy as np
import pytest

from adr_service.effects.base import Effect
from adr_service.effects.models import plausible_of, typical_of
from tests.effects.conftest import PLAIN
from tests.hidden import arm


def test_a_payload_is_a_point_mass_at_the_end_of_its_body():
    """The composite's inertia about the joint, by the parallel axis theorem."""
    nominal = arm()[1]
    before = nominal.model(nominal.start)
    after = nominal.model(nominal.start, [Effect("payload", "body:fore", (0.2,))])

    def about_joint(model):
        body = model.body("fore").id
        across = model.body_mass[body] * model.body_ipos[body, 2] ** 2
        rotation = np.empty(9)
        mujoco.mju_quat2Mat(rotation, model.body_iquat[body])
        frame = rotation.reshape(3, 3)
        return across + (frame @ np.diag(model.body_inertia[body]) @ frame.T)[1, 1]

    assert about_joint(after) - about_joint(before) == pytest.approx(0.2 * 0.5**2, rel=1e-9)
    assert after.body("fore").mass[0] - before.body("fore").mass[0] == pytest.approx(0.2)


def test_more_mass_takes_more_force(cart):
    """a = F / m under the actuator's constant force."""
    for mass in (0.0, 1.0):
        model = cart(Effect("body_mass", "body:cart", (mass,)))
        data = mujoco.MjData(model)
        data.ctrl[0] = 1.0
        mujoco.mj_forward(model, data)
        assert data.qacc[0] == pytest.approx(3.0 / (2.0 + mass), rel=1e-9)


def test_a_moved_centre_of_mass_leaves_the_mass(cart):
    before, after = cart(), cart(Effect("body_com", "body:cart", (0.1, 0.0, -0.2)))
    np.testing.assert_allclose(after.body("cart").ipos - before.body("cart").ipos, [0.1, 0.0, -0.2])
    np.testing.assert_array_equal(after.body_mass, before.body_mass)


def test_a_load_is_a_point_mass_where_its_moments_say():
    """The same as a payload, if it is where that one hangs."""
    nominal = arm()[1]
    carried, loaded = (
        nominal.model(nominal.start, [effect])
        for effect in (
            Effect("payload", "body:fore", (0.2,)),
            Effect("body_load", "body:fore", (0.2, 0.0, 0.0, -0.2 * 0.5)),
        )
    )
    forces: list[np.ndarray] = []
    for model in (carried, loaded):
        data = mujoco.MjData(model)
        data.qpos[:], data.qvel[:] = [0.4, -0.7], [1.0, 2.0]
        mujoco.mj_forward(model, data)
        data.qacc[:] = [3.0, -1.0]
        mujoco.mj_inverse(model, data)
        forces.append(data.qfrc_inverse.copy())
    np.testing.assert_allclose(forces[1], forces[0], rtol=1e-9)


def test_a_load_is_added_to_the_one_that_a_model_has(cart):
    loads = [Effect("body_load", "body:cart", (mass, 0.1, 0.0, 0.0)) for mass in (1.0, 0.5)]
    both, together = cart(*loads), cart(Effect("body_load", "body:cart", (1.5, 0.2, 0.0, 0.0)))
    np.testing.assert_allclose(both.body_mass, together.body_mass)
    np.testing.assert_allclose(both.body_ipos, together.body_ipos)
    assert both.body_mass.sum() == pytest.approx(2 + 1.5)


def test_gravity_is_compensated_for_the_link_and_not_for_its_load(cart):
    xml = PLAIN.replace('name="cart"', 'name="cart" gravcomp="1"').replace("1 0 0", "0 0 1")
    compensated = Effect("gravity_compensation", "body:cart", (-0.1,))
    for effects, missing in (
        ([], 0.0),
        ([compensated], 0.1 * 2.0),
        ([Effect("body_load", "body:cart", (0.5, 0.0, 0.0, 0.0))], 0.5),
    ):
        model = cart(*effects, xml=xml)
        data = mujoco.MjData(model)
        mujoco.mj_inverse(model, data)
        assert data.qfrc_inverse[0] == pytest.approx(9.81 * missing, abs=1e-9)


def test_a_body_without_extent_may_carry_a_load_beside_it(cart):
    assert all(size > 0 for size in typical_of(cart(), "body_load", "body:cart"))


HANDED = """<mujoco><worldbody>
<body name="base">{base}
  <body name="fore"><joint/><geom size=".1" mass="4"/>
    <body name="hand"><joint/><geom size=".02" mass=".4"/></body>
  </body>
</body>{beside}
</worldbody></mujoco>"""


@pytest.mark.parametrize(
    ("body", "base", "beside", "kilograms"),
    [
        ("hand", "", "", 0.25 * 4.4),
        ("fore", "", "", 0.5 * 4.0),  # more than a quarter of 4.4
        ("hand", '<geom size=".1" mass="200"/>', "", 0.25 * 4.4),
        ("hand", "", '<body><joint/><geom size=".1" mass="9"/></body>', 0.25 * 4.4),
    ],
    ids=["a hand", "a heavy link", "on a bench", "beside another robot"],
)
def test_what_a_robot_may_carry_goes_by_the_mass_that_moves_with_it(body, base, beside, kilograms):
    model = mujoco.MjModel.from_xml_string(HANDED.format(base=base, beside=beside))
    payload = Effect("payload", f"body:{body}", (1.0,))
    assert plausible_of(model, payload) == pytest.approx([kilograms])
    load = Effect("body_load", f"body:{body}", (1.0, 0.0, 0.0, 0.0))
    assert plausible_of(model, load) == pytest.approx(kilograms * np.array([1, 0.1, 0.1, 0.1]))


def test_a_positive_change_of_inertia_makes_it_larger(cart):
    before, after = cart(), cart(Effect("body_inertia", "body:cart", (0.5,)))
    expected = 1.5 * before.body("cart").inertia
    np.testing.assert_allclose(after.body("cart").inertia, expected)
