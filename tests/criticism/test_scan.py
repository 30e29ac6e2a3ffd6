"""The scan over all effects at all places."""

from dataclasses import replace

import mujoco
import numpy as np
import pytest

from adr_service.blind_test.planting import hide
from adr_service.criticism.decision import THRESHOLD
from adr_service.criticism.fits import fit
from adr_service.criticism.linear import Normal
from adr_service.criticism.measurements import Measurement
from adr_service.criticism.noise import Whitener
from adr_service.criticism.nominal import Nominal
from adr_service.criticism.probable_states import smoothed
from adr_service.criticism.responses import Responses
from adr_service.criticism.scan import Candidate, Scan, location_of, places, scan
from adr_service.criticism.simulator import Simulator
from adr_service.effects.base import Effect
from adr_service.parameters import ParameterSpace
from tests.hidden import arm


def test_one_effect_at_all_places_is_a_group():
    """With a strength for each, where it explains more than any single place."""
    hidden = [
        Effect("joint_coulomb_friction", "joint:shoulder", (0.2,)),
        Effect("joint_coulomb_friction", "joint:elbow", (0.1,)),
    ]
    task, nominal = arm()
    data = hide(task, nominal, np.random.default_rng(401), hidden).episodes(range(12))
    sensor = data.sensor_variance()
    with Simulator(nominal, data, threads=1, finer=3) as simulator:
        baseline = smoothed(fit(simulator, sensor))
        best, *others = scan(baseline, Responses(baseline))
    assert (best.kind, best.location) == ("joint_coulomb_friction", "joint:*")
    assert best.gain > max(c.gain for c in others if len(c.effects) == 1) + THRESHOLD
    strengths = {cause.location: cause.values[0] for cause in best.effects}
    expected = {cause.location: cause.values[0] for cause in hidden}
    assert strengths == pytest.approx(expected, rel=0.3)  # to first order


@pytest.mark.slow
def test_two_strengths_of_one_effect_do_not_hide_each_other():
    """This friction is gone at .7 rad/s, and nearly always the joint is faster."""
    hidden = Effect("joint_stribeck_friction", "joint:shoulder", (0.7, 1.0))
    (task, nominal), rng = arm(), np.random.default_rng(405)
    fast = np.repeat(rng.choice([-1.0, 1.0], (12, 19, 2)), 4, axis=1)
    data = hide(task, nominal, rng, [hidden], commands=fast)
    sensor = data.sensor_variance()
    with Simulator(nominal, data, threads=1, finer=3) as simulator:
        baseline = smoothed(fit(simulator, sensor))
        candidates = scan(baseline, Responses(baseline))
    found = next(c for c in candidates if (c.kind, c.location) == (hidden.kind, hidden.location))
    assert np.isfinite(found.limits).all()
    assert found.gain > max(c.gain for c in candidates if c.location != hidden.location)


def test_a_detection_limit_takes_the_other_strengths_of_an_effect_for_known(candidates):
    """A recording that shows Coulomb friction shows Stribeck's too, which includes it."""
    one, other = (
        next(c for c in candidates if (c.kind, c.location) == (kind, "joint:elbow"))
        for kind in ("joint_coulomb_friction", "joint_stribeck_friction")
    )
    assert other.limits[0] == pytest.approx(one.limits[0], rel=1e-6)


@pytest.mark.slow
def test_a_detection_limit_does_not_hang_on_two_episodes():
    """No evidence may. By all information, the limits would differ by a factor of 2.4."""
    limits = [limit_of_gain(moved) for moved in (12, 2)]
    assert 5 * limits[0] < limits[1] < np.inf


def limit_of_gain(moved):
    """Detection limit of the shoulder's gain, where it is commanded in so many of 12 episodes."""
    (task, nominal), rng = arm(), np.random.default_rng(407)
    commands = np.repeat(rng.uniform(-1.0, 1.0, (12, 19, 2)), 4, axis=1)
    commands[moved:, :, 0] = 0.0
    data = hide(task, nominal, rng, [], commands=commands)
    known = replace(nominal, space=ParameterSpace(()), start=np.empty(0))
    with Simulator(known, data, threads=1, finer=3) as simulator:
        baseline = smoothed(fit(simulator, data.sensor_variance()))
        candidates = scan(baseline, Responses(baseline))
    place = ("actuator_gain", "actuator:shoulder")
    return next(c.limits[0] for c in candidates if (c.kind, c.location) == place)


@pytest.mark.slow
def test_a_load_whose_mass_nothing_shows_keeps_the_one_that_was_tried():
    """The first link turns about its own origin. Without a mass there would be no moments."""
    task, nominal = arm()
    hidden = Effect("body_load", "body:upper", (0.1, 0.04, 0.0, -0.01))
    data = hide(task, nominal, np.random.default_rng(406), [hidden]).episodes(range(12))
    sensor = data.sensor_variance()
    with Simulator(nominal, data, threads=1, finer=3) as simulator:
        baseline = smoothed(fit(simulator, sensor))
        candidates = scan(baseline, Responses(baseline))
    load = next(c for c in candidates if (c.kind, c.location) == (hidden.kind, hidden.location))
    assert np.isinf(load.limits[0])
    assert load.gain > THRESHOLD
    assert load.effects[0].values[0] == load.tried[0].values[0]
    assert load.effects[0].values[1] == pytest.approx(0.04, rel=0.3)


@pytest.mark.parametrize("timestep", [0.005, pytest.param(0.002, marks=pytest.mark.slow)])
def test_a_delay_of_several_control_steps_is_found_at_about_its_size(timestep):
    """However fine the model's own steps are."""
    task, nominal = arm()
    xml = nominal.xml.replace('timestep="0.01"', f'timestep="{timestep}"')
    hidden = Effect("actuator_delay", "actuator:elbow", (0.045,))  # of steps of 20 ms
    data = hide(task, nominal, np.random.default_rng(407), [hidden]).episodes(range(12))
    sensor = data.sensor_variance()
    with Simulator(replace(nominal, xml=xml), data, threads=1) as simulator:
        assert simulator.base.opt.timestep == timestep
        baseline = smoothed(fit(simulator, sensor))
        best, *_ = scan(baseline, Responses(baseline))
    assert (best.kind, best.location) == (hidden.kind, hidden.location)
    assert best.effects[0].values == pytest.approx(hidden.values, rel=0.3)


@pytest.mark.slow
def test_the_drag_of_a_fast_wheel_is_found_at_about_its_size():
    """At 700 rad/s a drag that is sensible at one is hundreds of times the motor's torque."""
    xml = """<mujoco><option timestep="0.002"/><worldbody><body>
      <joint name="wheel" axis="0 0 1" damping="1e-5"/>
      <geom type="cylinder" size="0.05 0.01" mass="0.05"/></body></worldbody><actuator>
      <motor name="motor" joint="wheel" gear="0.1" ctrllimited="true" ctrlrange="-1 1"/>
      </actuator></mujoco>"""
    nominal = Nominal.of_model(xml, ParameterSpace(()))
    hidden, rng = (
        Effect("joint_quadratic_friction", "joint:wheel", (1e-7,)),
        np.random.default_rng(0),
    )
    with Simulator(nominal, turning(nominal, hidden, rng), threads=1) as simulator:
        baseline = smoothed(fit(simulator, simulator.data.sensor_variance()))
        candidates = scan(baseline, Responses(baseline))
    found = next(c for c in candidates if c.kind == hidden.kind)
    assert found.effects[0].values == pytest.approx(hidden.values, rel=0.2)


def turning(nominal, effect, rng):
    """A measurement of a wheel that turns at up to 700 rad/s."""
    model = nominal.model(nominal.start, [effect])
    data, rows = mujoco.MjData(model), []
    for episode in range(12):
        mujoco.mj_resetData(model, data)
        data.qvel[0], command = rng.uniform(-300, 300), 0.0
        for row in range(75):
            command = np.clip(0.95 * command + 0.3 * rng.standard_normal(), -1, 1)
            noisy = (1e-4, 5e-3) * rng.standard_normal(2) + (data.qpos[0], data.qvel[0])
            rows.append((0.01 * row, *noisy, command, episode))
            data.ctrl[0] = command
            mujoco.mj_step(model, data, nstep=5)
    time, position, velocity, commands, episodes = np.array(rows).T
    return Measurement(
        time, position[:, None], velocity[:, None], commands[:, None], episodes.astype(int)
    )


def test_a_group_is_named_after_the_kind_of_its_places():
    springs = [Effect("joint_spring", f"joint:{name}", (1.0,)) for name in ("shoulder", "elbow")]
    assert location_of(springs) == "joint:*"
    assert location_of(springs[:1]) == "joint:shoulder"


def test_sensors_without_readings_are_no_places():
    task, nominal = arm()
    data = hide(task, nominal, np.random.default_rng(401), []).episodes(range(2))
    unread = type(data)(data.time, data.qpos, data.qvel, data.ctrl, data.episode, [np.inf, 0.1])
    with (
        Simulator(nominal, data, threads=1) as all_read,
        Simulator(nominal, unread, threads=1) as one,
    ):
        missing = set(places(all_read)) - set(places(one))
    kinds = ("joint_backlash", "joint_encoder_scale")
    places_of_it = {(kind, "joint:shoulder") for kind in kinds}
    assert {e for e in missing if e[1] != "sensor:shoulder.position"} == places_of_it


def test_responses_of_an_earlier_fit_count_where_the_later_one_simulates(baseline):
    mask = baseline.linear.chain.mask.copy()
    mask[3, 40:] = False
    there = mask[..., None]
    linear = replace(
        baseline.linear,
        chain=baseline.linear.chain.where(mask),
        residual=np.where(there, baseline.linear.residual, 0.0),
        columns=np.where(there[..., None], baseline.linear.columns, 0.0),
    )
    normal = Normal.of(Whitener.of(linear.chain, baseline.noise), linear)
    later = replace(baseline, linear=linear, normal=normal)
    one, other = (scan(later, Responses(fitted)) for fitted in (baseline, later))
    assert [c.location for c in one[:20]] == [c.location for c in other[:20]]
    np.testing.assert_allclose([c.gain for c in one], [c.gain for c in other], rtol=1e-6)


@pytest.mark.parametrize("gain", [0.0, 0.1])
def test_the_size_that_is_nearest_to_its_limit_says_the_limit(gain, monkeypatch):
    """By a response that is not in proportion, much less would be enough, also where it gains."""
    sizes = [Effect("contact_softness", "geom:sole", (size,)) for size in (0.1, 0.5, 2.0)]
    limits = dict(zip(sizes, ([0.001], [0.7], [9.0]), strict=True))

    def at(self, tried):
        gains = np.array([gain, 0.0]) * (tried[0] == sizes[0])
        return Candidate(tuple(tried), tuple(tried), gains, np.array(limits[tried[0]]))

    monkeypatch.setattr(Scan, "_at", at)
    look = object.__new__(Scan)
    look._without = np.zeros(2)
    found = look.alone(sizes)
    assert found.limits == [0.7]
    assert found.tried == (sizes[0],)
    assert found.gain == gain
