"""Effects that data could show before anything is fitted."""

from dataclasses import replace

import numpy as np
import pytest

from adr_service.blind_test.planting import hide
from adr_service.criticism.excitation import excitation
from adr_service.criticism.measurements import Measurement
from adr_service.criticism.nominal import Nominal
from adr_service.criticism.simulator import Simulator
from adr_service.parameters import ParameterSpace
from tests.effects.conftest import PLAIN
from tests.hidden import arm, recorded
from tests.logs.conftest import XML


@pytest.fixture(scope="module")
def clean():
    """The arrays of an arm without any effect; noise of 1 mrad and 10 mrad/s."""
    return recorded(hide(*arm(), np.random.default_rng(403), []).episodes(range(12)))


@pytest.fixture(scope="module")
def found(clean):
    """By kind and place, of an arm that moves."""
    return _by_place(Measurement(**clean))


def _by_place(data):
    with Simulator(_fixed(arm()[1]), data, threads=1) as simulator:
        return {(each.kind, each.location): each for each in excitation(simulator, NOISE)}


NOISE = np.array([1e-3, 1e-3, 1e-2, 1e-2])


def _fixed(nominal):
    return replace(nominal, space=ParameterSpace(()), start=np.empty(0))


def test_nats_are_half_the_squares_of_a_response_in_errors_of_differences():
    """A cart of 2 kg, pushed for 2 ms in each of 110 transitions."""
    rows = np.arange(120)
    data = Measurement(
        time=0.002 * rows,
        qpos=np.zeros((120, 1)),
        qvel=np.where(rows % 2, 1.0, -1.0)[:, None],
        ctrl=np.zeros((120, 1)),
        episode=rows // 12,
    )
    with Simulator(Nominal.of_model(PLAIN, ParameterSpace(())), data, threads=1) as simulator:
        each = excitation(simulator, np.array([1e-6, 1e-3]))
    (push,) = (effect for effect in each if effect.kind == "actuator_bias")
    faster = push.sensible * 0.002 / 2  # [m/s]
    of_both = (faster / (np.sqrt(2) * 1e-3)) ** 2
    of_both += (0.002 * faster / np.hypot(np.sqrt(2) * 1e-6, 0.002 * 1e-3)) ** 2
    assert push.nats == pytest.approx(110 * of_both / 2, rel=1e-6)


def test_the_smallest_visible_size_is_where_an_effect_gains_the_threshold(found):
    """Twice as large, it gains four times as much."""
    each = found["joint_viscous_friction", "joint:elbow"]
    assert each.is_shown
    assert each.nats * (each.visible / each.sensible) ** 2 == pytest.approx(25)


def test_a_longer_recording_shows_smaller_effects(clean, found):
    part = _by_place(Measurement(**clean).episodes(range(8)))
    key = ("joint_viscous_friction", "joint:elbow")
    assert part[key].visible > found[key].visible


def test_a_robot_at_rest_shows_springs_and_no_friction():
    rows = 30 * 20
    data = Measurement(
        time=0.02 * np.arange(rows),
        qpos=np.full((rows, 2), 0.3),
        qvel=np.zeros((rows, 2)),
        ctrl=np.zeros((rows, 1)),
        episode=np.repeat(np.arange(20), 30),
    )
    floating = XML.replace("<option", '<option gravity="0 0 0"')
    nominal = Nominal.of_model(floating, ParameterSpace(()))
    with Simulator(nominal, data, threads=1) as simulator:
        nats = {(e.kind, e.location): e.nats for e in excitation(simulator, NOISE)}
    assert nats["joint_spring", "joint:shoulder"] > 0.01
    assert nats["joint_viscous_friction", "joint:shoulder"] < 1e-9
    assert nats["joint_coulomb_friction", "joint:shoulder"] < 1e-9


def test_a_position_that_is_not_measured_hides_only_what_it_alone_shows(clean, found):
    data = Measurement(**clean, qpos_std=[np.inf, 1e-3])
    with Simulator(_fixed(arm()[1]), data, threads=1) as simulator:
        blind = {
            (each.kind, each.location): each
            for each in excitation(simulator, np.array([np.nan, 1e-3, 1e-2, 1e-2]))
        }
    for key in (("joint_viscous_friction", "joint:shoulder"), ("actuator_gain", "actuator:elbow")):
        assert 0 < blind[key].nats <= found[key].nats
    assert found.keys() - blind.keys() >= {("joint_backlash", "joint:shoulder")}
    assert ("joint_backlash", "joint:elbow") in blind


def test_a_velocity_that_is_not_measured_hides_friction_but_not_all_of_it(clean, found):
    """Positions show the force still, with less certainty."""
    data = Measurement(**clean, qvel_std=[np.inf, np.inf])
    with Simulator(_fixed(arm()[1]), data, threads=1) as simulator:
        blind = excitation(simulator, np.array([1e-3, 1e-3, np.nan, np.nan]))
    key = ("joint_viscous_friction", "joint:elbow")
    (seen,) = [each for each in blind if (each.kind, each.location) == key]
    assert 0 < seen.nats < found[key].nats
    assert not [each for each in blind if each.location == "sensor:elbow.velocity"]
