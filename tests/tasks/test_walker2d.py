"""Walker2d's geometry follows its link lengths."""

import mujoco
import numpy as np
import pytest

from adr_service.tasks.catalogue import get_task, source_of
from tests.plain import inertial, rotation


@pytest.mark.parametrize("seed", range(5))
def test_walker2ds_geometry_follows_its_lengths(seed):
    """Heights of joints and ends of capsules when standing, and inertias, by random-envs' rule."""
    task, rng = get_task("walker2d"), np.random.default_rng(seed)
    torso, thigh, leg, foot = rng.uniform(0.15, 1.0, 4)
    spec = mujoco.MjSpec.from_string(task.xml)
    task.reshape(spec, {"torso": torso, "thigh": thigh, "leg": leg, "foot": foot})
    model = spec.compile()
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    assert data.joint("rooty").xanchor[2] == pytest.approx(1.25)
    hip = thigh + leg
    ends = {"torso": (hip, hip + torso)}
    for side in ("", "_left"):
        for joint, height in (("thigh", hip), ("leg", leg), ("foot", 0.1)):
            assert data.joint(f"{joint}{side}_joint").xanchor[2] == pytest.approx(height)
        ends |= {f"thigh{side}": (leg, hip), f"leg{side}": (0.1, leg), f"foot{side}": (0, foot)}
    for link, (low, high) in ends.items():
        axis = 0 if link.startswith("foot") else 2
        middle, half = data.geom(f"{link}_geom").xpos[axis], model.geom(f"{link}_geom").size[1]
        assert (middle - half, middle + half) == pytest.approx((low, high), abs=1e-12)
    for body in range(1, model.nbody):
        _, centre, moments = inertial(model, body)
        np.testing.assert_allclose(model.body_ipos[body], centre, atol=1e-14)
        turned = rotation(model.body_iquat[body])
        about = turned @ np.diag(model.body_inertia[body]) @ turned.T
        np.testing.assert_allclose(about, moments, atol=1e-14)


def test_both_legs_share_their_lengths_and_have_masses_of_their_own():
    space = source_of("walker2d", "vanilla").space
    assert [n for n in space.names if n.endswith("_length")] == [
        f"{link}_length" for link in ("torso", "thigh", "leg", "foot")
    ]
    assert {"thigh_mass", "thigh_left_mass"} <= set(space.names)


def test_the_files_own_lengths_change_nothing():
    task = get_task("walker2d")
    plain = mujoco.MjSpec.from_string(task.xml)
    reshaped = mujoco.MjSpec.from_string(task.xml)
    task.reshape(reshaped, {})
    for field in ("body_pos", "body_ipos", "body_inertia", "geom_pos", "geom_size"):
        one, other = (getattr(spec.compile(), field) for spec in (plain, reshaped))
        np.testing.assert_allclose(one, other, rtol=1e-12, atol=1e-15, err_msg=field)
