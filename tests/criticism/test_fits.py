"""Fits of a simulator to a measurement, with effects and without."""

from dataclasses import replace

import mujoco
import numpy as np
import pytest

from adr_service.blind_test.planting import hide
from adr_service.criticism.decision import is_evidence
from adr_service.criticism.evidence import expected_errors
from adr_service.criticism.fits import fit, refine, tried
from adr_service.criticism.intervals import intervals
from adr_service.criticism.measurements import Measurement
from adr_service.criticism.nominal import Nominal
from adr_service.criticism.probable_states import smoothed
from adr_service.criticism.simulator import Simulator
from adr_service.effects.base import Effect
from adr_service.effects.models import plausible_of
from adr_service.parameters import Parameter, ParameterSpace
from tests.hidden import arm, driven

BIAS = Effect("sensor_bias", "sensor:elbow.position", (0.05,))


def hinge(damping, rotor, mass):
    """A drive that turns a ball on a rod of 30 cm."""
    return f"""<mujoco><option timestep="0.005" integrator="implicitfast"/><worldbody>
        <body name="ball"><joint name="x" axis="0 1 0" damping="{damping}" armature="{rotor}"/>
        <geom size="0.05" pos="0.3 0 0" mass="{mass}"/></body></worldbody>
        <actuator><motor joint="x" gear="2"/></actuator></mujoco>"""


@pytest.fixture(scope="module")
def turned():
    """Episodes of a hinge with a damping of 0.5 and a ball of 1 kg, and no rotor."""
    whole = Measurement(**driven(mujoco.MjModel.from_xml_string(hinge(0.5, 0.0, 1.0)), 1e-4))
    return whole.episodes(range(6))


FREE = {
    "damping": ("joint:x.damping", 0.0, 10.0),
    "rotor": ("joint:x.armature", 0.0, 5.0),
    "mass": ("body:ball.inertial", 0.01, 10.0),
}


def space(**bounds):
    """The parameters of a hinge within bounds."""
    chosen = {name: (FREE[name][0], *given) for name, given in bounds.items()}
    return ParameterSpace(
        tuple(Parameter(name, at, "", low, high, low) for name, (at, low, high) in chosen.items())
    )


@pytest.mark.parametrize(
    "start",
    [
        pytest.param((0.005, 2.0, 0.3), marks=pytest.mark.slow),
        pytest.param((0.02, 0.5, 1.0), marks=pytest.mark.slow),
        (5.0, 0.001, 3.0),
    ],
    ids=str,
)
def test_parameters_that_start_far_off_the_truth_are_recovered(turned, start):
    """Inertias from a fortieth to twenty times the truth: one step's derivatives lead nowhere."""
    free = space(**{name: bounds for name, (_, *bounds) in FREE.items()})
    with Simulator(Nominal.of_model(hinge(*start), free), turned, threads=1) as simulator:
        found = smoothed(fit(simulator, turned.sensor_variance()))
    np.testing.assert_allclose(found.parameters, [0.5, 0.0, 1.0], rtol=0.01, atol=0.001)


def test_a_better_point_is_taken_although_its_own_noise_is_smaller(turned):
    """Under which what is still to go would look larger than what there was."""
    nominal = Nominal.of_model(hinge(0.5, 0.0, 3.0), space(mass=(0.01, 10.0)))
    with Simulator(nominal, turned, threads=1) as simulator:
        assert fit(simulator, turned.sensor_variance()).parameters == pytest.approx(1.0, rel=0.2)


@pytest.mark.slow
def test_what_only_a_parameter_beyond_its_bounds_would_explain_is_evidence(turned):
    missing = Effect("joint_viscous_friction", "joint:x", (0.35,))

    def fitted(high):
        nominal = Nominal.of_model(hinge(0.1, 0.0, 1.0), space(damping=(0.05, high)))
        with Simulator(nominal, turned, threads=1) as simulator:
            found = smoothed(fit(simulator, turned.sensor_variance()))
            return found, refine(found, [missing])

    held, extended = fitted(0.15)
    assert held.parameters == 0.15
    assert abs(held.normal.change()[0][0]) < 1e-6
    assert is_evidence(extended.held_out - held.held_out)
    whole = extended.parameters[0] + extended.effects[0].values[0]
    assert whole == pytest.approx(0.5, rel=0.01)
    free, beside = fitted(10.0)
    assert free.parameters == pytest.approx(0.5, rel=0.01)
    assert not is_evidence(beside.held_out - free.held_out)


def rubbing(*effects, loss=0.0, density=0.0):
    """A hinge with a friction and air in its model, whose robot has these effects instead."""
    xml = hinge(0.1, 0.0, 1.0).replace("armature", f'frictionloss="{loss}" armature')
    xml = xml.replace("<option", f'<option density="{density}"')
    nominal, bare = (Nominal.of_model(each, space()) for each in (xml, hinge(0.1, 0.0, 1.0)))
    data = Measurement(**driven(bare.model(bare.start, effects), 1e-4)).episodes(range(6))
    return Simulator(nominal, data, threads=1)


def test_what_only_a_negative_strength_would_explain_is_no_evidence_for_it():
    """The model has more friction than the robot, and no effect takes any away."""
    friction = Effect("joint_coulomb_friction", "joint:x", (0.01,))
    with rubbing(loss=0.02) as simulator:
        baseline = smoothed(fit(simulator, simulator.data.sensor_variance())).settled
        refined = refine(baseline, [friction])
    assert refined.effects[0].values == (0.0,)
    assert not is_evidence(refined.held_out - baseline.held_out)


@pytest.mark.slow
def test_nor_is_it_where_the_strength_stands_beside_others():
    """It comes as near to nothing as makes no difference, and never to nothing.

    Less air would gain 1,800 nats; the wind itself, in the air that the model has, gains 28.
    """
    wind = Effect("wind", "global", (30.0, 1.0, 1.0))
    with rubbing(density=60.0) as simulator:
        baseline = smoothed(fit(simulator, simulator.data.sensor_variance())).settled
        refined = refine(baseline, [wind])
    assert refined.effects[0].values[0] == pytest.approx(0.0, abs=0.1)
    assert intervals(refined, slice(0, 1))[0].low <= 0
    assert (refined.held_out - baseline.held_out).sum() < 60


@pytest.mark.parametrize("start", [(0.03, 0.3), (0.05, 0.02)], ids=str)
def test_strengths_that_must_not_be_negative_are_recovered_together(start):
    """A step that leads beyond a bound is cut as a whole; cut alone, one would stay at nothing."""
    truth = Effect("joint_stribeck_friction", "joint:x", (0.1, 0.05))
    with rubbing(truth) as simulator:
        baseline = smoothed(fit(simulator, simulator.data.sensor_variance()))
        refined = refine(baseline, [replace(truth, values=start)])
    assert refined.effects[0].values == pytest.approx(truth.values, rel=0.05)


def test_a_missing_effect_is_recovered_from_half_of_its_strength(refined):
    assert refined.effects[0].values[0] == pytest.approx(0.1, rel=0.1)


def test_a_start_far_away_reaches_the_same_strength_with_derivatives_of_its_own(
    baseline, refined, friction
):
    """Each of four steps at most takes a prediction, better states one, derivatives three more."""
    simulator, once = baseline.simulator, len(baseline.simulator.starts)
    spent = simulator.simulated_steps
    refine(baseline, refined.effects)
    near = simulator.simulated_steps - spent
    far = refine(baseline, [replace(friction, values=(1.0,))])
    again = simulator.simulated_steps - spent - near
    assert far.effects[0].values == pytest.approx(refined.effects[0].values, rel=0.02)
    assert near <= 8 * once < again


def test_the_noise_of_sensors_is_estimated(refined):
    """Planted: 1 mrad and 10 mrad/s."""
    np.testing.assert_allclose(np.sqrt(refined.noise.sensor), [1e-3, 1e-3, 1e-2, 1e-2], rtol=0.2)
    assert np.all(expected_errors(refined) > np.sqrt(refined.noise.sensor))


def test_an_effect_without_mass_left_explains_nothing(baseline):
    gone = Effect("body_mass", "body:fore", (-5.0,))
    assert refine(baseline, [gone]) is None


def test_columns_of_strengths_follow_those_of_integration(refined):
    columns = refined.columns_of(slice(0, 1))
    assert (columns.start, columns.stop) == (refined.integration.stop, refined.integration.stop + 1)
    assert refined.linear.columns.shape[3] == columns.stop


def test_a_supposed_effect_has_a_prior_about_zero_and_a_known_one_has_none(baseline, refined):
    column = refined.columns_of(slice(0, 1)).start
    (likely,) = plausible_of(baseline.simulator.base, refined.effects[0])
    assert refined.normal.precision[column] == pytest.approx(1 / likely**2)
    assert refined.normal.mean[column] == pytest.approx(-refined.effects[0].values[0])
    known = fit(baseline.simulator, baseline.simulator.data.sensor_variance(), refined.effects)
    assert known.normal.precision[column] == 0.0


def test_errors_are_expected_of_inferred_states_where_nobody_measured_them(turned):
    """The spread of velocities, in which no sensor was read, is no error."""
    unread = replace(turned, qvel_std=np.full(1, np.inf))
    nominal = Nominal.of_model(hinge(0.5, 0.0, 1.0), space())
    expected = []
    for data in (turned, unread):
        with Simulator(nominal, data, threads=1) as simulator:
            expected.append(expected_errors(smoothed(fit(simulator, data.sensor_variance()))))
    assert np.isnan(expected[1][1])
    assert expected[0][0] < expected[1][0] < 3 * expected[0][0]


def test_another_effect_in_a_sensor_moves_what_is_read_of_the_same_states(baseline):
    """Were the readings to stay, the robot would move, and into the ground that it stands on."""
    scale = Effect("sensor_scale", "sensor:shoulder.position", (0.5,))
    found = tried(baseline, [BIAS, scale])
    np.testing.assert_allclose(found.true_states, baseline.true_states, atol=1e-12)
    expected = baseline.true_states * [1.5, 1.0, 1.0, 1.0] + [0.0, *BIAS.values, 0.0, 0.0]
    np.testing.assert_allclose(found.states, expected, atol=1e-12)


@pytest.mark.parametrize(
    ("kind", "place", "values"),
    [
        ("sensor_bias", "sensor:elbow.position", (0.01,)),
        ("sensor_bias", "sensor:elbow.velocity", (0.05,)),
        ("sensor_scale", "sensor:shoulder.velocity", (0.05,)),
        ("sensor_delay", "sensor:elbow.position", (0.002,)),
        ("sensor_delay", "sensor:elbow.velocity", (0.002,)),
        ("joint_encoder_scale", "joint:elbow", (0.05,)),
        ("joint_backlash", "joint:elbow", (0.02,)),
    ],
)
def test_residuals_follow_the_derivatives_by_strengths_in_sensors(baseline, kind, place, values):
    """Beside another effect in the same sensor, which acts first."""
    first = Effect("sensor_scale", "sensor:elbow.position", (0.1,))
    begun, moved = (
        tried(baseline, [first, Effect(kind, place, (factor * values[0],))])
        for factor in (1.0, 1.02)
    )
    foretold = 0.02 * values[0] * begun.linear.columns[..., -1]
    change = begun.linear.residual - moved.linear.residual
    assert np.linalg.norm(change) > 0
    assert np.linalg.norm(change - foretold) < 0.15 * np.linalg.norm(change)


def test_an_effect_is_judged_about_states_that_are_probable_with_it():
    """An offset of fifty times the noise, about which no model of an arm is linear."""
    data = hide(*arm(), np.random.default_rng(406), [BIAS]).episodes(range(8))
    with Simulator(arm()[1], data, threads=1, finer=3) as simulator:
        baseline = smoothed(fit(simulator, data.sensor_variance()))
        refined = refine(baseline, [BIAS])
        settled = smoothed(refined)
    (found,), (true,) = refined.effects[0].values, BIAS.values
    assert found == pytest.approx(true, rel=0.02)
    gains = [(each.held_out - baseline.held_out).sum() for each in (refined, settled)]
    assert gains[0] == pytest.approx(gains[1], rel=0.03)


def test_an_episode_that_diverges_from_its_probable_states_keeps_those_that_it_has(
    baseline, friction, monkeypatch
):
    """And others take theirs."""
    simulator, predict = baseline.simulator, baseline.simulator.predict

    def moved():
        refined = refine(baseline, [replace(friction, values=(0.05,))])
        spans = simulator.data.spans()
        both = (refined.states, baseline.states)
        return [n for n, (a, b) in enumerate(spans) if not np.array_equal(*(s[a:b] for s in both))]

    gone, *_ = moved()
    first, last = simulator.transitions()[gone]

    def diverging(values, effects, states):
        predicted = predict(values, effects, states)
        predicted[first:last] = np.nan
        return predicted

    monkeypatch.setattr(simulator, "predict", diverging)
    others = moved()
    assert others
    assert gone not in others


def test_a_strength_that_was_nothing_has_derivatives_once_it_is_something(baseline):
    """A strength that the data do not identify beside others is zero, and has no derivatives."""
    kind, place = "joint_stribeck_friction", "joint:elbow"
    begun = tried(baseline, [Effect(kind, place, (0.1, 0.0))])
    assert begun.columns_at(Effect(kind, place, (0.11, 0.0))) is not None
    assert begun.columns_at(Effect(kind, place, (0.11, 0.1))) is None
    whole = tried(begun, [Effect(kind, place, (0.11, 0.1))])
    assert not begun.linear.columns[..., -1].any()
    assert whole.linear.columns[..., -1].any()
