"""A flexible force, beside fits that lack something and fits that lack nothing."""

import mujoco
import numpy as np
import pytest

from adr_service.blind_test.outside import Force
from adr_service.blind_test.planting import draw_case, hide
from adr_service.criticism.decision import is_evidence
from adr_service.criticism.fits import fit, refine
from adr_service.criticism.flexible_force import _own_forces, unexplained
from adr_service.criticism.measurements import Measurement
from adr_service.criticism.nominal import Nominal
from adr_service.criticism.pipeline import split
from adr_service.criticism.probable_states import smoothed
from adr_service.criticism.simulator import Simulator
from adr_service.effects.base import Effect
from adr_service.parameters import ParameterSpace
from tests.hidden import arm


def found(nominal, data, *effects):
    """A flexible force beside a fit that already has these effects."""
    sensor = data.sensor_variance()
    with Simulator(nominal, data, threads=1, finer=3) as simulator:
        baseline = smoothed(fit(simulator, sensor))
        return unexplained(refine(baseline, effects))


@pytest.mark.slow
def test_a_flexible_force_gains_nothing_where_nothing_is_hidden(clean):
    assert not is_evidence(found(arm()[1], Measurement(**clean)).gains)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("seed", "ratio", "effect", "depends_on"),
    [(300, 1.0, "gain_drift", "time"), (301, 0.3, "disturbance", "frequency")],
)
def test_a_flexible_force_gains_where_an_effect_outside_the_catalogue_is(
    seed, ratio, effect, depends_on
):
    case = draw_case(*arm(), np.random.default_rng(seed), ratio, outside=True)
    assert case.outside == effect
    rest = found(case.nominal, case.measurement.episodes(range(12)))
    assert is_evidence(rest.gains)
    assert rest.where.depends_on == depends_on
    assert rest.where.hertz == (pytest.approx(2.7, rel=0.01) if effect == "disturbance" else None)


FRICTION = Effect("joint_coulomb_friction", "joint:elbow", (0.01,))
GAIN = Effect("actuator_gain", "actuator:elbow", (-0.02,))
FADE = Effect("actuator_fade", "actuator:elbow", (0.07,))


@pytest.mark.parametrize(
    ("kind", "dof", "size", "mean", "depends_on"),
    [
        ("position_dependent_friction", 1, 0.1, (FRICTION,), "position"),
        pytest.param("cross_coupling", 1, 0.3, (), "motion", marks=pytest.mark.slow),
    ],
)
def test_what_varies_about_a_named_mean_is_found_with_its_joint(kind, dof, size, mean, depends_on):
    force = Force(kind, dof, actuator=dof, other=1 - dof, size=size)  # of a motor of 12 N m
    data = hide(*arm(), np.random.default_rng(5), [], force).episodes(range(12))
    rest = found(arm()[1], data, *mean)
    assert rest.gains.sum() > 100
    joint = ("joint:shoulder", "joint:elbow")[dof]
    assert (rest.where.location, rest.where.depends_on) == (joint, depends_on)


@pytest.mark.slow
def test_a_torque_ripple_that_is_not_named_depends_on_position():
    ripple = Effect("joint_torque_ripple", "joint:shoulder", (0.2, 0.0, 12.0))
    data = hide(*arm(), np.random.default_rng(5), [ripple]).episodes(range(12))
    rest = found(arm()[1], data)
    assert rest.gains.sum() > 100
    assert (rest.where.location, rest.where.depends_on) == ("joint:shoulder", "position")


@pytest.mark.slow
def test_a_swing_is_found_at_its_frequency_where_every_fourth_episode_is_sealed():
    force = Force("disturbance", dof=1, actuator=1, other=0, size=0.3)
    learned, _ = split(hide(*arm(), np.random.default_rng(5), [], force))
    rest = found(arm()[1], learned)
    assert rest.where.hertz == pytest.approx(2.7, rel=0.002)


SWUNG = """
<mujoco><option timestep="0.005"/><worldbody><body>
<joint name="slide" type="slide" axis="1 0 0" damping="1"/><geom size=".1" mass="1"/></body>
</worldbody><tendon><fixed name="cord"><joint joint="slide" coef="1"/></fixed></tendon>
<actuator><motor name="pull" {drive} gear="5"/></actuator></mujoco>
"""


@pytest.mark.parametrize("drive", ['joint="slide"', 'tendon="cord"'])
@pytest.mark.parametrize(
    ("hidden", "depends_on"),
    [
        (lambda data, u: -0.2 * u * data.time / 0.4, "time"),
        (lambda data, u: 0.1 * u * np.sin(40 * data.qpos[0]), "drive"),
    ],
)
def test_what_a_drive_does_is_found_however_it_pulls(drive, hidden, depends_on):
    nominal = Nominal.of_model(SWUNG.format(drive=drive), ParameterSpace(()))
    rest = found(nominal, swung(nominal, 14, hidden))
    assert is_evidence(rest.gains)
    assert (rest.where.location, rest.where.depends_on) == ("joint:slide", depends_on)


@pytest.mark.parametrize(
    "seed", [0, *(pytest.param(seed, marks=pytest.mark.slow) for seed in (1, 2))]
)
def test_forces_that_are_correlated_in_time_are_no_swing(seed):
    """First-order noise, which lasts for a tenth of a second."""
    nominal = Nominal.of_model(SWUNG.format(drive='joint="slide"'), ParameterSpace(()))
    beside = iter(correlated(np.random.default_rng(seed)))
    data = swung(nominal, 30, lambda data, u: next(beside))
    assert not is_evidence(found(nominal, data).gains)


def correlated(rng):
    force = 0.0
    while True:
        force = 0.95 * force + 0.1 * rng.standard_normal()
        yield force


def swung(nominal, episodes, hidden):
    """A measurement of a slide that a hidden force pulls as well."""
    model = nominal.model(nominal.start)
    data, rng, rows = mujoco.MjData(model), np.random.default_rng(6), []
    for episode in range(episodes):
        mujoco.mj_resetData(model, data)
        for row in range(41):
            command = float(np.sign(np.sin(0.4 * row + episode)) * rng.uniform(0.3, 1))
            shown = rng.normal([data.qpos[0], data.qvel[0]], [1e-4, 1e-3])
            rows.append((episode, 0.01 * row, *shown, command))
            for _ in range(2):
                data.ctrl[0], data.qfrc_applied[0] = command, hidden(data, command)
                mujoco.mj_step(model, data)
    episode, time, q, v, u = np.array(rows).T
    return Measurement(time, q[:, None], v[:, None], u[:, None], episode.astype(int))


@pytest.mark.slow
def test_a_gain_that_fades_within_every_episode_is_more_than_its_mean():
    data = hide(*arm(), np.random.default_rng(5), [FADE]).episodes(range(12))
    rest = found(arm()[1], data, GAIN)
    assert rest.gains.sum() > 300
    assert (rest.where.location, rest.where.depends_on) == ("joint:elbow", "time")


def test_a_flexible_force_adds_nothing_to_the_true_effect(refined):
    assert not is_evidence(unexplained(refined.settled).gains)


def test_every_episode_has_its_own_gain(baseline):
    gained = unexplained(baseline).gains
    assert gained.shape == (8,)
    assert np.all(np.isfinite(gained))


@pytest.mark.parametrize(
    "drive",
    [
        '<motor name="drive" joint="j" gear="3" ctrllimited="true" ctrlrange="-1 1"/>',
        '<position name="drive" joint="j" gear="2" kp="40" kv="1.5"/>',
        '<position name="drive" joint="j" kp="100" forcerange="-1 1"/>',
        '<general name="drive" joint="j" gainprm="2" biasprm="0 -10 0"/>',
    ],
)
def test_a_drive_is_asked_by_its_force(drive):
    """A servo's set-point says nothing of friction that grows with load."""
    model = mujoco.MjModel.from_xml_string(
        '<mujoco><worldbody><body><joint name="j" axis="0 1 0"/><geom size="0.1" mass="1"/></body>'
        f"</worldbody><actuator>{drive}</actuator></mujoco>"
    )
    q, v, command = np.array([0.3, -0.2]), np.array([1.0, -2.0]), np.array([[0.4], [-3.0]])
    expected, data = [], mujoco.MjData(model)
    for row in range(2):
        data.qpos[0], data.qvel[0], data.ctrl[0] = q[row], v[row], command[row, 0]
        mujoco.mj_forward(model, data)
        expected.append(data.actuator_force[0])
    np.testing.assert_allclose(_own_forces(model, np.array([0]), command, q, v)[:, 0], expected)
