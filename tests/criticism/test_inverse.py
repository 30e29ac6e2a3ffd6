"""Forces that a motion needs beyond the simulator's, on whole arms."""

from dataclasses import replace

import mujoco
import numpy as np
import pytest

from adr_service.criticism.inverse import _possible, missing_forces, needed_effects
from adr_service.criticism.measurements import Measurement
from adr_service.criticism.nominal import Nominal
from adr_service.criticism.pipeline import criticise
from adr_service.criticism.simulator import Simulator
from adr_service.effects.base import Effect
from adr_service.parameters import ParameterSpace
from benchmarks.arms import ARMS, hidden, model_of, recorded
from tests.effects.conftest import PLAIN

LINKS = ARMS[6]


@pytest.fixture(scope="module")
def bare():
    """An arm of six joints without friction and rotors."""
    return Nominal.of_model(model_of(LINKS), ParameterSpace(()))


@pytest.fixture(scope="module")
def robot():
    """Everything that the real arm has beyond it."""
    return hidden(LINKS, np.random.default_rng(1))


@pytest.fixture(scope="module")
def data(bare, robot):
    return recorded(bare, LINKS, robot, np.random.default_rng(2)).episodes(range(16))


def needed(nominal, data):
    with Simulator(nominal, data, threads=1) as simulator:
        return needed_effects(simulator)


def test_forces_show_friction_and_rotors_at_all_joints_and_the_load(bare, robot, data):
    groups = needed(bare, data)
    found = {(e.kind, e.location): e.values[0] for group in groups for e in group}
    true = {(e.kind, e.location): e.values[0] for e in robot if e.kind != "gravity_compensation"}
    assert found.keys() == true.keys()
    for place, strength in true.items():
        if place[1] in ("joint:joint1", "joint:joint2", "joint:joint3", "joint:joint4"):
            assert found[place] == pytest.approx(strength, rel=0.15), place  # a first guess


def test_a_rotor_needs_its_inertia_times_the_acceleration(bare, data):
    rotor = Effect("joint_armature", "joint:joint3", (0.2,))
    with Simulator(bare, data, threads=1) as simulator:
        more = missing_forces(simulator, [rotor]) - missing_forces(simulator, [])
        change = simulator.measured[simulator.starts + 1] - simulator.measured[simulator.starts]
    expected = np.zeros_like(more)
    expected[:, 2] = 0.2 * change[:, 6 + 2] / simulator.period
    np.testing.assert_allclose(more, expected, atol=1e-9)


def test_velocities_that_nobody_measured_show_no_forces(bare, data):
    assert needed(bare, replace(data, qvel_std=np.inf)) == ()


def test_an_actuator_without_a_gain_lacks_no_bias(bare):
    """MuJoCo's dampers have none; a typical bias of zero has no evidence that is a number."""
    spec = bare.spec(bare.start)
    joint = spec.joints[0].name
    damper = spec.add_actuator(name="damper", target=joint, trntype=mujoco.mjtTrn.mjTRN_JOINT)
    damper.set_to_damper(1.0)
    damper.ctrlrange = [0, 1]
    effects = list(_possible(spec.compile()))
    assert all(any(effect.values) for effect in effects)
    assert "actuator_bias" in {effect.kind for effect in effects}
    assert "actuator:damper" not in {effect.location for effect in effects}


def test_a_motion_exactly_as_expected_needs_no_forces():
    """A cart that coasts, without any noise."""
    cart = Nominal.of_model(PLAIN, ParameterSpace(()))
    rows = np.arange(240)
    time = 0.01 * rows
    data = Measurement(time, time[:, None], np.ones((240, 1)), np.zeros((240, 1)), rows // 24)
    assert needed(cart, data) == ()


@pytest.mark.slow
def test_an_arm_without_friction_and_rotors_gets_them_at_once(bare, robot, data):
    found = criticise(bare, data, np.random.default_rng(0), threads=1)
    named = {(cause.kind, cause.location) for cause in found.verdict.causes}
    assert named >= {
        ("joint_coulomb_friction", "joint:*"),
        ("joint_viscous_friction", "joint:*"),
        ("joint_armature", "joint:*"),
        ("body_load", "body:link6"),
    }
    assert any("on to the next one" in remark for remark in found.verdict.remarks)
    strengths = {(e.kind, e.location): e.values[0] for e in found.final.effects}
    for effect in robot:
        if effect.kind != "gravity_compensation":
            place = (effect.kind, effect.location)
            assert strengths[place] == pytest.approx(effect.values[0], rel=0.15), place
