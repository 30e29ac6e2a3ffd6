"""Every effect a simulator may lack: nothing at zero strength, and the same when written out."""

import mujoco
import numpy as np
import pytest

from adr_service.criticism.extension import extend
from adr_service.criticism.measurements import Measurement
from adr_service.criticism.nominal import Nominal
from adr_service.criticism.simulator import Simulator
from adr_service.effects.base import Commands, Effect
from adr_service.effects.catalogue import MECHANISMS, get_mechanism
from adr_service.effects.models import element_of, unit_of
from adr_service.errors import UnknownName
from adr_service.parameters import ParameterSpace
from adr_service.tasks.catalogue import get_task, source_of
from benchmarks.planted import draw_case

COMMANDS = Commands(np.array([[1.0, 1.0, -0.5, 0.2, 0.0, 0.8]]), 0.01, 1.0)


def small(name):
    """A task's simulator and a short recording that moves every joint."""
    task, rng = get_task(name), np.random.default_rng(0)
    nominal = Nominal.of_task(task, source_of(name, "vanilla"))
    state = task.initial(1, rng)
    rows = 4 * 27
    qpos = state.qpos + 0.1 * rng.standard_normal((rows, state.qpos.shape[1]))
    period = nominal.model(nominal.start).opt.timestep * task.frame_skip
    return Simulator(
        nominal,
        Measurement(
            time=np.tile(np.arange(27) * period, 4),
            qpos=qpos,
            qvel=rng.standard_normal((rows, state.qvel.shape[1])),
            ctrl=rng.uniform(task.action_low, task.action_high, (rows, len(task.action_low))),
            episode=np.repeat(np.arange(4), 27),
        ),
        threads=1,
    )


@pytest.fixture(scope="module", params=["arm", "hopper", "half_cheetah"])
def simulator(request):
    return small(request.param)


@pytest.mark.parametrize("kind", MECHANISMS)
def test_zero_strength_is_nothing_and_what_is_written_out_predicts_the_same(kind, simulator):
    mechanism, start = get_mechanism(kind), simulator.nominal.start
    for place in mechanism.locations(simulator.base)[-2:]:
        nothing = Effect(kind, place, (0.0,) * len(mechanism.strengths))
        typical = mechanism.typical(simulator.base, element_of(simulator.base, place))
        cause = Effect(kind, place, tuple(typical))
        without = simulator.predict(start, [], simulator.measured)
        np.testing.assert_array_equal(
            simulator.predict(start, [nothing], simulator.measured), without
        )
        changed = simulator.predict(start, [cause], simulator.measured)
        extension = extend(simulator.nominal, start, [cause])
        again = Simulator(extension.nominal(), simulator.data, threads=1)
        written = again.predict(np.empty(0), extension.beside, again.measured)
        np.testing.assert_allclose(written, changed, rtol=0, atol=1e-9)
        # the arm has no contacts
        if not kind.startswith("contact") and not mechanism.only_spreads:
            assert np.nanmax(np.abs(changed - without)) > 0


def test_places_are_named_and_unknown_ones_refused(simulator):
    places = [p for m in MECHANISMS.values() for p in m.locations(simulator.base)]
    assert "global" in places
    assert all(p == "global" or p.split(":")[1] for p in places)
    with pytest.raises(UnknownName, match="there is no mechanism 'rust'"):
        get_mechanism("rust")


def test_a_delay_of_whole_steps_shifts_commands_and_a_part_of_one_mixes_two():
    delay = get_mechanism("actuator_delay").command
    np.testing.assert_allclose(delay(COMMANDS, np.array([0.02])), [[0.0, 0.0, 1.0, 1.0, -0.5, 0.2]])
    np.testing.assert_allclose(
        delay(COMMANDS, np.array([0.0025])), [[0.75, 1.0, -0.125, 0.025, 0.05, 0.6]]
    )


def test_a_lag_is_the_mean_of_the_exact_first_order_response():
    seconds, constant = np.linspace(0, 0.01, 10_001), 0.03
    exact = 1 - np.exp(-seconds / constant)  # of a step from rest
    found = get_mechanism("actuator_lag").command(COMMANDS, np.array([constant]))
    assert found[0, 0] == pytest.approx(np.trapezoid(exact, seconds) / 0.01, rel=1e-6)


def test_a_deadband_and_a_saturation_cut_what_they_should():
    told = get_mechanism("actuator_deadband").command(COMMANDS, np.array([0.3]))
    np.testing.assert_allclose(told, [[0.7, 0.7, -0.2, 0.0, 0.0, 0.5]])
    told = get_mechanism("actuator_saturation").command(COMMANDS, np.array([0.4]))
    np.testing.assert_allclose(told, [[0.6, 0.6, -0.5, 0.2, 0.0, 0.6]])


def test_a_payload_is_a_point_mass_at_the_end_of_its_body():
    """The composite's inertia about the joint, by the parallel axis theorem."""
    nominal = Nominal.of_task(get_task("arm"), source_of("arm", "vanilla"))
    before = nominal.model(nominal.start)
    after = nominal.model(nominal.start, [Effect("payload", "body:fore", (0.2,))])

    def about_joint(model):
        body = model.body("fore").id
        across = model.body_mass[body] * model.body_ipos[body, 2] ** 2
        rotation = np.empty(9)
        mujoco.mju_quat2Mat(rotation, model.body_iquat[body])
        frame = rotation.reshape(3, 3)
        return across + (frame @ np.diag(model.body_inertia[body]) @ frame.T)[1, 1]

    assert about_joint(after) - about_joint(before) == pytest.approx(0.2 * 0.5**2, rel=1e-9)
    assert after.body("fore").mass[0] - before.body("fore").mass[0] == pytest.approx(0.2)


def brakes(default):
    """A slide with these defaults of actuators, that starts at 1 m/s and at -1 m/s."""
    xml = f"""
    <mujoco><default><general {default}/></default>
    <worldbody><body name="cart"><joint name="x" type="slide" axis="1 0 0"/>
    <geom size=".1" mass="2"/></body></worldbody>
    <actuator><general name="push" joint="x" gear="3" dyntype="none"/></actuator></mujoco>"""
    rows = np.arange(120)
    data = Measurement(
        time=0.002 * rows,
        qpos=np.zeros((120, 1)),
        qvel=np.where(rows % 2, 1.0, -1.0)[:, None],
        ctrl=np.zeros((120, 1)),
        episode=rows // 12,
    )
    return Simulator(Nominal.of_model(xml, ParameterSpace(())), data, threads=1)


@pytest.mark.parametrize("default", ["", 'gear="50" dyntype="integrator" forcerange="-1 1"'])
@pytest.mark.parametrize("damping", [4.0, -4.0])
def test_a_brake_acts_one_way_whatever_the_defaults_are(default, damping):
    """v(t) = v exp(-|d| t / m) for one sign of v; implicit Euler to first order."""
    slide = brakes(default)
    cause = Effect("joint_asymmetric_viscous_friction", "joint:x", (damping,))
    after = slide.predict(np.empty(0), [cause], slide.measured)[:, 1]
    before = slide.measured[slide.starts, 1]
    braked = np.sign(before) == np.sign(damping)
    np.testing.assert_array_equal(after[~braked], before[~braked])
    np.testing.assert_allclose(after[braked], before[braked] * np.exp(-0.002 * 4 / 2), rtol=1e-4)


def test_an_extended_model_can_be_criticised_again_and_a_zero_still_is_nothing():
    slide = brakes("")
    causes = [
        Effect("joint_asymmetric_viscous_friction", "joint:x", (4.0,)),
        Effect("external_force", "body:cart", (1.0, 0.0, 0.0)),
    ]
    extended = extend(slide.nominal, np.empty(0), causes).nominal()
    again = Simulator(extended, slide.data, threads=1)
    assert not [p for m in MECHANISMS.values() for p in m.locations(again.base) if "adr_" in p]
    without = again.predict(np.empty(0), [], again.measured)
    for cause in causes:
        nothing = Effect(cause.kind, cause.location, (0.0,) * len(cause.values))
        np.testing.assert_array_equal(
            again.predict(np.empty(0), [nothing], again.measured), without
        )


def test_a_sensor_with_a_scale_shows_what_a_robot_without_it_does():
    slide = brakes("")
    cause = Effect("sensor_scale", "sensor:x.velocity", (0.2,))
    shown = slide.measured * [1.0, 1.2]
    found = slide.predict(np.empty(0), [cause], shown)
    expected = slide.predict(np.empty(0), [], slide.measured)
    np.testing.assert_allclose(found[:, 0], expected[:, 0], atol=1e-12)
    np.testing.assert_allclose(found[:, 1], 1.2 * expected[:, 1], atol=1e-12)


def test_a_slide_has_units_of_its_own():
    model = brakes("").base
    assert unit_of(model, "joint:x", "N m s/rad") == "N s/m"
    assert unit_of(model, "actuator:push", "N m") == "N"
    assert unit_of(model, "sensor:x.velocity", "of the sensor") == "m/s"
    hinge = Nominal.of_task(get_task("arm"), source_of("arm", "vanilla"))
    assert unit_of(hinge.model(hinge.start), "joint:elbow", "N m s/rad") == "N m s/rad"


def test_a_case_is_the_same_for_the_same_generator_and_starts_off_the_truth():
    task = get_task("arm")
    nominal = Nominal.of_task(task, source_of("arm", "vanilla"))
    one, other = (draw_case(task, nominal, np.random.default_rng(5), 0.3) for _ in range(2))
    assert one.effects == other.effects
    np.testing.assert_array_equal(one.measurement.qpos, other.measurement.qpos)
    assert np.all(one.nominal.start != nominal.start)
