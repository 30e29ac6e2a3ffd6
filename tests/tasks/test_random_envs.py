"""The four robots of the benchmark are those of random-envs, the paper's environments."""

import warnings
from pathlib import Path

import gymnasium
import mujoco
import numpy as np
import pytest

from adr_service.simulation.batch import control_period
from adr_service.simulation.model import compiled
from adr_service.tasks.catalogue import get_task, variants_of
from tests.plain import inertial, rotation

GYMNASIUM = Path(gymnasium.__file__).parent / "envs/mujoco/assets"
PAPER = {  # Tiboni et al., Table 1: observations, actions, parameters (unmodeled)
    "hopper": (11, 3, 4, 3),
    "half_cheetah": (17, 6, 8, 5),
    "walker2d": (17, 6, 13, 9),
    "humanoid": (376, 17, 30, 23),
}


@pytest.mark.parametrize("name", PAPER)
def test_dimensions_are_those_of_the_paper(name):
    task, variants = get_task(name), variants_of(name)
    observations, actions, parameters, unmodeled = PAPER[name]
    assert len(task.columns) == len(set(task.columns)) == observations
    assert len(task.action_low) == len(task.action_high) == actions
    assert len(variants["vanilla"].source.space) == parameters
    assert len(variants["noisy"].source.space) == parameters
    assert len(variants["unmodeled"].source.space) == unmodeled
    assert task.measured == {"humanoid": 45}.get(name, observations)


@pytest.mark.parametrize("name", PAPER)
def test_settings_are_those_of_random_envs(name):
    task = get_task(name)
    timing = {"half_cheetah": 0.05, "humanoid": 0.015}.get(name, 0.008)
    assert control_period(task) == pytest.approx(timing)
    thresholds = {"hopper": 1750, "half_cheetah": 4500, "walker2d": 2200, "humanoid": 2200}
    assert task.reward_threshold == thresholds[name]
    assert task.learning_rate == (1e-4 if name == "humanoid" else 5e-4)
    noise = 1e-3 if name in ("walker2d", "humanoid") else 1e-4
    assert variants_of(name)["noisy"].hidden.noise_variance == noise
    assert task.horizon == 500
    options = compiled(task.xml).opt
    assert options.disableflags & mujoco.mjtDisableBit.mjDSBL_WARMSTART
    euler = mujoco.mjtIntegrator.mjINT_EULER
    runge_kutta = mujoco.mjtIntegrator.mjINT_RK4
    assert options.integrator == (euler if name == "half_cheetah" else runge_kutta)


@pytest.mark.parametrize("name", PAPER)
def test_masses_and_inertias_are_those_of_mujoco_2_1_0(name):
    model = compiled(get_task(name).xml)
    scale = 14 if name == "half_cheetah" else None  # kg, settotalmass
    expected = [inertial(model, body) for body in range(1, model.nbody)]
    factor = scale / sum(mass for mass, _, _ in expected) if scale else 1.0
    for body, (mass, centre, moments) in enumerate(expected, start=1):
        assert model.body_mass[body] == pytest.approx(factor * mass, rel=1e-12)
        np.testing.assert_allclose(model.body_ipos[body], centre, atol=1e-14)
        turned = rotation(model.body_iquat[body])
        about = turned @ np.diag(model.body_inertia[body]) @ turned.T
        np.testing.assert_allclose(about, factor * moments, atol=1e-13)


@pytest.mark.parametrize("name", PAPER)
def test_joints_motors_shapes_and_contacts_are_those_of_gymnasiums_models(name):
    """docs/tasks.md lists the differences that are on purpose."""
    ours = compiled(get_task(name).xml)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        theirs = mujoco.MjModel.from_xml_path(f"{GYMNASIUM}/{name}.xml")
    fields = ["jnt_type", "jnt_axis", "jnt_range", "jnt_limited", "jnt_stiffness", "jnt_solref"]
    fields += ["jnt_solimp", "dof_damping", "dof_armature", "actuator_gear", "qpos0"]
    fields += ["actuator_ctrlrange", "geom_type", "geom_size", "geom_condim", "geom_solref"]
    fields += ["geom_solimp", "geom_contype", "geom_conaffinity", "geom_friction"]
    for field in fields:
        one, other = getattr(ours, field), getattr(theirs, field).copy()
        if (name, field) == ("walker2d", "geom_friction"):
            other[-1, 0] = 0.9  # the left foot's 1.9 is a contact pair's here
        np.testing.assert_allclose(one, other, atol=1e-12, err_msg=field)
    for option in ("timestep", "gravity", "integrator", "solver", "iterations"):
        np.testing.assert_array_equal(getattr(ours.opt, option), getattr(theirs.opt, option))
    feet = {"half_cheetah": [0.4, 0.4], "walker2d": [0.9, 1.9]}.get(name, [])
    np.testing.assert_array_equal(ours.pair_friction[:, 0], feet)
    np.testing.assert_array_equal(ours.pair_friction[:, 1], feet)
    np.testing.assert_array_equal(ours.pair_dim, [3] * len(feet))


@pytest.mark.parametrize("name", ["hopper", "humanoid"])
def test_two_geoms_touch_at_the_published_margin(name):
    """Since MuJoCo 3.5 the margins of two geoms are summed."""
    margins = compiled(get_task(name).xml).geom_margin
    assert set((margins[:, None] + margins).ravel()) == {0.001}
