"""Effects from outside the robot obey mechanics."""

import mujoco
import numpy as np
import pytest

from adr_service.effects.base import Effect


def test_a_tilt_turns_gravity_and_keeps_its_size(cart):
    model = cart(Effect("gravity_tilt", "global", (0.1, 0.2)))
    assert np.linalg.norm(model.opt.gravity) == pytest.approx(9.81)
    assert model.opt.gravity[2] == pytest.approx(-9.81 * np.cos(0.1) * np.cos(0.2))


def test_the_size_of_gravity_changes_in_proportion(cart):
    model = cart(Effect("gravity_magnitude", "global", (-0.5,)))
    np.testing.assert_allclose(model.opt.gravity, [0.0, 0.0, -4.905])


@pytest.mark.parametrize("force", [5.0, -2.0])
def test_a_constant_force_accelerates_a_body_by_its_mass(cart, force):
    model = cart(Effect("external_force", "body:cart", (force, 0.0, 7.0)))
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    assert data.qacc[0] == pytest.approx(force / 2.0, rel=1e-9)


def test_wind_pushes_what_drag_only_brakes(cart):
    """A still cart feels no drag, and is pushed by wind along its slide."""
    accelerations = []
    for effect in (
        Effect("fluid_drag", "global", (1.2,)),
        Effect("wind", "global", (1.2, 3.0, 0.0)),
    ):
        model = cart(effect)
        data = mujoco.MjData(model)
        mujoco.mj_forward(model, data)
        accelerations.append(data.qacc[0])
    assert accelerations[0] == 0.0
    assert accelerations[1] > 0.0


@pytest.mark.parametrize(
    ("tilt", "expected"),
    [
        ((0.1, 0.0), [np.sin(0.1), 0.0, np.cos(0.1)]),
        ((0.0, 0.1), [0.0, -np.sin(0.1), np.cos(0.1)]),
    ],
)
def test_a_positive_tilt_turns_gravity_backwards_or_to_the_left(cart, tilt, expected):
    """As rotations by the right-hand rule about y (pitch) and about x (roll)."""
    model = cart(Effect("gravity_tilt", "global", tilt))
    np.testing.assert_allclose(model.opt.gravity, -9.81 * np.array(expected), atol=1e-12)


def test_wind_has_its_density_and_both_speeds(cart):
    model = cart(Effect("wind", "global", (1.2, 3.0, -2.0)))
    assert (model.opt.density, model.opt.wind.tolist()) == (1.2, [3.0, -2.0, 0.0])
