"""Effects that data could show before anything is fitted."""

from dataclasses import replace

import numpy as np
import pytest

from adr_service.blind_test.planting import hide
from adr_service.criticism.excitation import excitation
from adr_service.criticism.measurements import Measurement
from adr_service.criticism.nominal import Nominal
from adr_service.criticism.simulator import Simulator
from adr_service.effects.models import typical_of
from adr_service.parameters import ParameterSpace
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


def test_an_effect_twice_as_large_gains_four_times_as_much(found):
    """So the smallest visible size is where it gains the threshold of 25 nats."""
    each = found["joint_viscous_friction", "joint:elbow"]
    assert each.is_shown
    assert each.nats * (each.visible / _typical(each)) ** 2 == pytest.approx(25)


def _typical(each):
    nominal = arm()[1]
    return typical_of(nominal.model(nominal.start), each.kind, each.location)[0]


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
