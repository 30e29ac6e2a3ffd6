"""A mechanism that this file adds is scanned, planted, named and exported like ours."""

import numpy as np
import pytest

from adr_service.blind_test.planting import hide
from adr_service.criticism.fits import fit
from adr_service.criticism.pipeline import criticise
from adr_service.criticism.probable_states import smoothed
from adr_service.criticism.responses import Responses
from adr_service.criticism.scan import scan
from adr_service.criticism.simulator import Simulator
from adr_service.effects.base import Effect, Mechanism, Sensing, Strength
from adr_service.effects.catalogue import MECHANISMS, add
from adr_service.errors import InvalidInput
from tests.hidden import arm


def _stiffen(model, joint, values):
    """A spring that pulls to .3 rad, where the arm's file has no spring at all."""
    if values[0] != 0:
        model.jnt_stiffness[joint] += values[0]
        model.qpos_spring[model.jnt_qposadr[joint]] = 0.3


PULL = Mechanism(
    "test_pull",
    "joint",
    (Strength("stiffness", "N m/rad"),),
    typical=lambda model, joint: (0.05,),
    change=_stiffen,
)


def _sagging(motion, values):
    return values[0] * motion.states[:, motion.column] ** 2


def _sagged(truth, values, period):
    return truth + values[0] * truth**2


SAG = Mechanism(
    "test_sensor_sag",
    "sensor",
    (Strength("sag", "1"),),
    typical=lambda model, sensor: (0.01,),
    sensing=Sensing(_sagging, _sagged),
)


@pytest.fixture
def pull():
    add(PULL)
    yield Effect("test_pull", "joint:elbow", (1.0,))
    del MECHANISMS[PULL.kind]


@pytest.fixture
def sag():
    add(SAG)
    yield Effect("test_sensor_sag", "sensor:elbow.velocity", (0.002,))
    del MECHANISMS[SAG.kind]


def planted(effect, episodes):
    """A measurement of an arm that has the effect."""
    task, nominal = arm()
    return hide(task, nominal, np.random.default_rng(500), [effect]).episodes(range(episodes))


@pytest.mark.slow
def test_a_new_mechanism_is_scanned_planted_named_and_exported(pull):
    nominal, data = arm()[1], planted(pull, 8)
    criticism = criticise(nominal, data, np.random.default_rng(0), threads=1)
    (cause,) = criticism.verdict.causes
    assert (cause.kind, cause.location) == (pull.kind, pull.location)
    assert cause.strengths[0].value == pytest.approx(pull.values[0], rel=0.1)
    (exported,) = criticism.extension.to_json()["effects"]
    assert (exported["kind"], exported["in_mjcf"]) == (pull.kind, True)
    written = criticism.extension.nominal().model(np.empty(0))
    assert written.joint("elbow").stiffness[0] == pytest.approx(pull.values[0], rel=0.1)


def test_a_new_mechanism_in_a_sensor_is_the_best_candidate_where_it_is_planted(sag):
    data = planted(sag, 8)
    sensor = data.sensor_variance()
    with Simulator(arm()[1], data, threads=1) as simulator:
        baseline = smoothed(fit(simulator, sensor))
        best = scan(baseline, Responses(baseline))[0]
    assert (best.kind, best.location) == (sag.kind, sag.location)
    assert best.effects[0].values[0] == pytest.approx(sag.values[0], rel=0.3)  # to first order


def test_a_kind_that_is_taken_is_refused(pull):
    with pytest.raises(InvalidInput, match="there is a mechanism 'test_pull' already"):
        add(PULL)
