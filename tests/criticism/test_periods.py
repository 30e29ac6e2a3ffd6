"""Forces and frictions that repeat with the angle of a joint, found among residuals."""

from dataclasses import replace

import numpy as np
import pytest

from adr_service.blind_test.planting import hide
from adr_service.criticism.evidence import gained, held_out_without
from adr_service.criticism.fits import fit, refine
from adr_service.criticism.measurements import Measurement
from adr_service.criticism.nominal import Nominal
from adr_service.criticism.periods import waves_in_turn
from adr_service.criticism.pipeline import criticise
from adr_service.criticism.probable_states import smoothed
from adr_service.criticism.responses import Responses
from adr_service.criticism.scan import scan
from adr_service.criticism.simulator import Simulator
from adr_service.effects.base import Effect
from adr_service.effects.catalogue import MECHANISMS
from adr_service.parameters import ParameterSpace
from tests.hidden import arm


def rippling(waves, *others):
    """A recording of the arm, whose elbow ripples so often in a turn."""
    ripple = Effect("joint_torque_ripple", "joint:elbow", (0.05, 0.025, waves))
    return hide(*arm(), np.random.default_rng(5), [ripple, *others])


def waves_of(nominal, data):
    with Simulator(nominal, data, threads=1, finer=3) as simulator:
        start = fit(simulator, data.sensor_variance())
        kind, responses = "joint_torque_ripple", Responses(start)
        hinges = MECHANISMS[kind].locations(simulator.base)
        return waves_in_turn(start, {hinge: responses.to_unit(kind, hinge) for hinge in hinges})


@pytest.mark.parametrize("waves", [7.5, 60.0])
def test_the_waves_of_a_ripple_are_found_to_a_fraction_of_one(waves):
    found = waves_of(arm()[1], rippling(waves).episodes(range(12)))
    assert found["joint:elbow"] == pytest.approx(waves, abs=0.5)


def test_what_repeats_once_in_a_turn_is_left_to_weights():
    """The arm turns often, so that it would be resolved."""
    data = rippling(1.0).episodes(range(12))
    assert np.ptp(data.qpos[:, 1]) > 3 * np.pi
    assert waves_of(arm()[1], data)["joint:elbow"] >= 2


def test_a_joint_that_turns_very_far_is_asked_for_slower_waves():
    """As many as the angles' bins resolve, and no joint for none."""
    data = rippling(17.3).episodes(range(12))
    turned = [replace(data, qpos=data.qpos * [1.0, factor]) for factor in (5e3, 1e5)]
    far, farther = (waves_of(arm()[1], each) for each in turned)
    assert 2 <= far["joint:elbow"] < 5
    assert "joint:elbow" not in farther


def test_a_joint_that_hardly_moves_has_no_waves():
    """A hundredth of a radian is less than two waves of 400 in a turn."""
    xml = (
        '<mujoco><option gravity="0 0 0"/><worldbody><body><joint name="a"/><geom size=".1"/>'
        '</body></worldbody><actuator><motor joint="a"/></actuator></mujoco>'
    )
    angles = 0.01 * np.sin(np.arange(60) / 10)
    still = Measurement(
        time=0.002 * np.arange(60),
        qpos=angles[:, None],
        qvel=np.gradient(angles, 0.002)[:, None],
        ctrl=np.zeros((60, 1)),
        episode=np.arange(60) // 20,
    )
    nominal = Nominal.of_model(xml, ParameterSpace(()))
    assert waves_of(nominal, still) == {}
    moved = replace(still, qpos=100 * still.qpos, qvel=100 * still.qvel)
    assert 2 * 2 * np.pi / np.ptp(moved.qpos) <= waves_of(nominal, moved)["joint:a"] <= 400


@pytest.mark.slow
def test_a_ripple_is_named_beside_friction_with_how_often_it_repeats():
    friction = Effect("joint_coulomb_friction", "joint:elbow", (0.02,))
    data = rippling(17.3, friction).episodes(range(12))
    verdict = criticise(arm()[1], data, np.random.default_rng(0), threads=1).verdict
    found = {(cause.kind, cause.location): cause.strengths for cause in verdict.causes}
    kinds = ("joint_torque_ripple", "joint_coulomb_friction")
    assert set(found) == {(kind, "joint:elbow") for kind in kinds}
    sine, cosine, waves = found["joint_torque_ripple", "joint:elbow"]
    assert sine.low < 0.05 < sine.high
    assert cosine.low < 0.025 < cosine.high
    assert waves.low < 17.3 < waves.high
    assert waves.value == pytest.approx(17.3, rel=0.01)


@pytest.mark.slow
def test_friction_that_varies_with_load_or_position_is_named_as_that():
    truth = [
        Effect("joint_load_dependent_friction", "joint:elbow", (0.1,)),
        Effect("joint_position_dependent_friction", "joint:shoulder", (0.1, 0.04, 0.03, 9.0)),
    ]
    data = hide(*arm(), np.random.default_rng(1), truth).episodes(range(12))
    criticism = criticise(arm()[1], data, np.random.default_rng(0), threads=1)
    found = {(c.kind, c.location): c.strengths for c in criticism.verdict.causes}
    assert set(found) == {(effect.kind, effect.location) for effect in truth}
    for effect in truth:
        for strength, value in zip(found[effect.kind, effect.location], effect.values, strict=True):
            assert strength.low < value < strength.high
            assert strength.value == pytest.approx(value, rel=0.2)
    assert criticism.verdict.residual.rest == "none"
    assert {effect.kind for effect in criticism.extension.beside} == {c.kind for c in truth}


@pytest.mark.slow
def test_friction_that_varies_about_the_models_own_is_a_candidate():
    """Its mean is nothing then, and an estimate of it may be negative."""
    kind, place = "joint_position_dependent_friction", "joint:elbow"
    task, nominal = arm()
    rough = replace(
        nominal,
        xml=nominal.xml.replace('name="elbow" damping', 'name="elbow" frictionloss=".1" damping'),
    )
    assert rough.model(rough.start).joint("elbow").frictionloss[0] == 0.1
    means = []
    for seed in range(2):
        wave = Effect(kind, place, (0.0, 0.05, 0.03, 9.0))
        data = hide(task, rough, np.random.default_rng(seed), [wave]).episodes(range(12))
        with Simulator(rough, data, threads=1, finer=3) as simulator:
            start = fit(simulator, data.sensor_variance())
            best = scan(start, Responses(start))[0]
        assert (best.kind, best.location) == (kind, place)
        assert best.effects[0].values[1:] == pytest.approx((0.05, 0.03, 9.0), rel=0.5)
        means.append(best.effects[0].values[0])
    assert min(means) < 0 < max(means)


@pytest.mark.slow
def test_the_linearised_loss_without_a_ripple_is_about_the_true_one():
    """It decides whether a ripple is superfluous; its waves are no amount that could be lost."""
    data, ripple = rippling(17.3).episodes(range(12)), (0.05, 0.025, 17.3)
    with Simulator(arm()[1], data, threads=1, finer=3) as simulator:
        start = smoothed(fit(simulator, data.sensor_variance()))
        effect = Effect("joint_torque_ripple", "joint:elbow", ripple)
        final = smoothed(refine(start, [effect]))
        linearised = (held_out_without(final, []) - held_out_without(final, [0])).sum()
        exact = gained(final.settled, refine(final, [])).sum()
    assert linearised == pytest.approx(exact, rel=0.2)
