"""Many simulations at once, each under commands of its own."""

import mujoco
import numpy as np
import pytest

from adr_service.criticism.engine import Engine
from adr_service.effects.base import Effect

LOAD = [Effect("joint_load_dependent_friction", "joint:x", (0.3,))]
NOTHING = [Effect("joint_load_dependent_friction", "joint:x", (0.0,))]


@pytest.fixture
def servo():
    """A cart that a servo moves, with some friction."""
    return mujoco.MjModel.from_xml_string(
        """<mujoco><worldbody><body><joint name="x" type="slide" frictionloss="1"/>
        <geom size=".1" mass="2"/></body></worldbody>
        <actuator><position joint="x" kp="400"/></actuator></mujoco>"""
    )


def commands(n, steps):
    """(n, steps, 2) goals of the servo, and a force beside it."""
    return np.random.default_rng(1).normal(size=(n, steps, 2))


def starts(n):
    return np.random.default_rng(0).normal(size=(n, 2))


def test_friction_is_worked_out_anew_at_every_step(servo):
    control, expected = commands(5, 40), []
    for start, given in zip(starts(5), control, strict=True):
        data = mujoco.MjData(servo)
        data.qpos[:], data.qvel[:] = start[:1], start[1:]
        for goal, force in given:
            data.ctrl[0], data.qfrc_applied[0] = goal, force
            servo.dof_frictionloss[0] = 1 + 0.3 * 400 * abs(goal - data.qpos[0])
            mujoco.mj_step(servo, data)
        expected.append([data.qpos[0], data.qvel[0]])
    servo.dof_frictionloss[0] = 1
    found = Engine(servo, 1).run(servo, LOAD, starts(5), control)
    np.testing.assert_allclose(found[:, -1], expected, rtol=1e-9)


@pytest.mark.parametrize("integrator", ["EULER", "RK4", "IMPLICITFAST"])
def test_one_step_after_the_other_is_what_a_rollout_does_to_the_last_bit(servo, integrator):
    servo.opt.integrator = getattr(mujoco.mjtIntegrator, f"mjINT_{integrator}")
    engine = Engine(servo, 1)
    known = starts(50), commands(50, 20)
    one, other = (engine.run(servo, effects, *known) for effects in ([], NOTHING))
    np.testing.assert_array_equal(one, other)
    assert one.shape == (50, 20, 2)


def test_frictions_that_vary_are_the_same_at_any_number_of_threads(servo):
    known = servo, LOAD, starts(50), commands(50, 20)
    np.testing.assert_array_equal(Engine(servo, 1).run(*known), Engine(servo, 3).run(*known))


def test_a_model_with_more_elements_has_a_state_of_its_own(servo):
    """MuJoCo would write beyond the memory of a smaller one."""
    engine = Engine(servo, 1)
    assert engine._data(servo) is engine._scratch
    spec = mujoco.MjSpec()
    body = spec.worldbody.add_body()
    body.add_joint(name="x")
    body.add_geom(size=[0.1, 0, 0])
    spec.add_tendon(name="strap").wrap_joint("x", 1.0)
    own = engine._data(spec.compile())
    assert own is not engine._scratch
    assert own[0].ten_length.shape == (1,)


@pytest.mark.parametrize("effects", [[], LOAD])
def test_what_diverges_is_not_a_number_and_leaves_the_others_alone(servo, effects):
    engine, given = Engine(servo, 1), starts(3)
    alone = engine.run(servo, effects, given[:1], commands(1, 20))
    given[1, 1] = 1e13
    found = engine.run(servo, effects, given, np.repeat(commands(1, 20), 3, axis=0))
    assert np.isnan(found[1]).all()
    np.testing.assert_array_equal(found[0], alone[0])
    assert np.isfinite(found[2]).all()


@pytest.mark.parametrize("integrator", ["EULER", "IMPLICITFAST"])
@pytest.mark.parametrize("effects", [[], LOAD])
@pytest.mark.parametrize("step", [0, 7, 19])
def test_what_diverges_in_between_stays_as_it_was_until_then(servo, effects, integrator, step):
    """MuJoCo stops a rollout at a force of 1e11 N, and repeats the last state."""
    servo.opt.integrator = getattr(mujoco.mjtIntegrator, f"mjINT_{integrator}")
    engine, control = Engine(servo, 1), commands(3, 20)
    alone = engine.run(servo, effects, starts(3), control)
    control[1, step, 1] = 1e11
    found = engine.run(servo, effects, starts(3), control)
    assert np.isnan(found[1, step:]).all()
    np.testing.assert_array_equal(found[1, :step], alone[1, :step])
    np.testing.assert_array_equal(found[[0, 2]], alone[[0, 2]])


def test_a_rollout_that_stops_is_not_taken_for_a_robot_that_stops(servo):
    """An implicit integrator makes a small step of a huge acceleration, and MuJoCo stops there."""
    servo.opt.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    servo.dof_damping[:] = 1e11
    found = Engine(servo, 1).run(servo, [], np.ones((1, 2)), commands(1, 20))
    np.testing.assert_array_equal(np.isnan(found[0, :, 0]), np.arange(20) > 0)
    servo.dof_damping[:] = 1e6
    assert np.isfinite(Engine(servo, 1).run(servo, [], np.ones((1, 2)), commands(1, 20))).all()
