"""Extended models as files."""

import mujoco
import numpy as np
import pytest

from adr_service.criticism.extension import NotWritable, extend, written_out
from adr_service.criticism.nominal import Nominal
from adr_service.effects.base import Effect
from adr_service.parameters import ParameterSpace
from benchmarks.arms import ARMS, hidden, model_of
from tests.hidden import arm

SPRING = Effect("joint_spring", "joint:elbow", (1 / 3,))
DELAY = Effect("actuator_delay", "actuator:elbow", (0.01,))


def test_an_extension_has_every_digit_of_its_parameters_and_effects():
    nominal = arm()[1]
    values = nominal.start * np.pi / 3
    written = extend(nominal, values, [SPRING]).nominal().model(np.empty(0))
    expected = nominal.model(values, [SPRING])
    np.testing.assert_array_equal(written.jnt_stiffness, expected.jnt_stiffness)
    np.testing.assert_array_equal(written.body_mass, expected.body_mass)


def test_an_extended_arm_is_the_robot_that_lacked_nothing():
    """It carries a load and compensates gravity wrongly, as no task of ours does."""
    links = ARMS[7]
    bare = Nominal.of_model(model_of(links), ParameterSpace(()))
    effects = hidden(links, np.random.default_rng(0))
    written = extend(bare, bare.start, effects).nominal().model(np.empty(0))
    expected = bare.model(bare.start, effects)
    for field in ("body_gravcomp", "body_mass", "body_ipos", "dof_frictionloss", "dof_armature"):
        np.testing.assert_array_equal(getattr(written, field), getattr(expected, field), field)


TWO_LINKS = """<mujoco><compiler {compiler}/><worldbody><body name="upper">
<joint name="shoulder" axis="0 1 0"/>
<geom type="capsule" fromto="0 0 0 .3 0 0" size=".03" mass="1"/>
<body name="lower" pos=".3 0 0"><joint name="elbow" axis="0 1 0" {elbow}/>
<geom type="capsule" fromto="0 0 0 .3 0 0" size=".03" mass=".3"/>
<body name="tip" pos=".3 0 0">
<inertial pos="0 0 0" mass="1e-4" diaginertia="1e-7 1e-7 1e-7"/></body>
</body></body></worldbody>
<tendon><fixed name="belt" stiffness="{belt}" springlength="-1"><joint joint="shoulder" coef="1"/>
<joint joint="elbow" coef="-1"/></fixed></tendon>
<actuator><motor joint="shoulder"/>{drive}</actuator></mujoco>"""
RESOLVED = {  # by MuJoCo, as it compiles
    "least masses": {"compiler": 'boundmass="0.001" boundinertia="0.0001"'},
    "static bodies": {"compiler": 'fusestatic="true"'},
    "a ratio of damping": {"drive": '<position joint="elbow" kp="20" dampratio="1"/>'},
    "a spring and damper": {"elbow": 'springdamper="0.3 1"'},
    "the length of a tendon": {"belt": "5", "elbow": 'ref="0.4"'},
}


FLAT = """<mujoco><worldbody><body name="plate">
<inertial pos="0.1 0 0" mass="1" {}/>
<joint axis="0 1 0"/><geom size=".1" pos=".2 0 0"/></body></worldbody></mujoco>"""


@pytest.mark.parametrize(
    "inertia",
    ['diaginertia="0.012 0.013 0.025"', 'fullinertia="0.012 0.025 0.013 0 0.001 0"'],
)
@pytest.mark.parametrize("kind", ["body_inertia", "payload"])
def test_a_flat_body_whose_moments_are_rounded_is_written(inertia, kind):
    """MuJoCo refuses a file in which the largest moment exceeds the others' sum by one bit."""
    nominal = Nominal.of_model(FLAT.format(inertia), ParameterSpace(()))
    for value in np.linspace(0.01, 0.2, 12).tolist():
        effects = [Effect(kind, "body:plate", (value,))]
        fitted = nominal.model(nominal.start, effects).body_inertia
        written = extend(nominal, nominal.start, effects).nominal().model(np.empty(0)).body_inertia
        np.testing.assert_allclose(written, fitted, rtol=1e-15)


def test_a_model_that_mujoco_simulates_but_does_not_write_is_refused_with_its_words():
    nominal = arm()[1]
    mass = float(nominal.model(nominal.start).body("fore").mass[0])
    weightless = Effect("body_mass", "body:fore", (-mass,))
    with pytest.raises(NotWritable, match=r"it says: .* must be larger than mjMINVAL"):
        extend(nominal, nominal.start, [weightless])


def moved(model):
    """The state after half a second."""
    data = mujoco.MjData(model)
    data.qpos[:], data.qvel[:], data.ctrl[:2] = 0.3, 1.0, 0.2
    mujoco.mj_step(model, data, nstep=250)
    return np.concatenate([data.qpos, data.qvel])


@pytest.mark.parametrize("given", RESOLVED.values(), ids=RESOLVED)
@pytest.mark.parametrize(
    ("kind", "place", "values"),
    [
        ("body_load", "body:lower", (0.05, 0.01, 0.0, 0.0)),
        ("body_mass", "body:lower", (0.5,)),
        ("joint_armature", "joint:elbow", (0.05,)),
        ("joint_reference_offset", "joint:elbow", (0.1,)),
    ],
)
def test_what_mujoco_works_out_as_it_compiles_is_worked_out_once(given, kind, place, values):
    """An effect changes no more than it says, and the written model moves as the fitted one."""
    robot = TWO_LINKS.format(**{"compiler": "", "elbow": "", "belt": "0", "drive": "", **given})
    nominal = Nominal.of_model(robot, ParameterSpace(()))
    effects = [Effect(kind, place, values)]
    nothing = [Effect(kind, place, tuple(0.0 for _ in values))]
    expected = moved(mujoco.MjModel.from_xml_string(robot))
    np.testing.assert_allclose(moved(nominal.model(nominal.start)), expected, rtol=1e-9)
    np.testing.assert_array_equal(
        moved(nominal.model(nominal.start, nothing)), moved(nominal.model(nominal.start))
    )
    fitted = moved(nominal.model(nominal.start, effects))
    assert not np.allclose(fitted, expected, rtol=1e-4)
    written = extend(nominal, nominal.start, effects).nominal().model(np.empty(0))
    np.testing.assert_allclose(moved(written), fitted, rtol=1e-9)


def test_the_lines_to_write_into_ones_own_file_are_told():
    nominal = arm()[1]
    friction = Effect("joint_coulomb_friction", "joint:shoulder", (0.25,))
    fitted = 1.02 * nominal.start  # free parameters that moved are not among them
    (spring, loss) = sorted(
        extend(nominal, fitted, [SPRING, friction]).changes, key=lambda line: "loss" in line
    )
    assert spring == '<joint name="elbow" stiffness="0.333333">'
    assert loss == '<joint name="shoulder" frictionloss="0.25">'
    assert extend(nominal, nominal.start, [DELAY]).changes == ()


def test_elements_without_a_name_are_told_by_what_is_around_them():
    robot = """<mujoco><worldbody><body name="link"><joint/><geom size="1"/></body></worldbody>
    </mujoco>"""
    nominal = Nominal.of_model(robot, ParameterSpace(()))
    spring = Effect("joint_spring", "joint:unnamed_0", (0.3,))
    assert extend(nominal, nominal.start, [spring]).changes == (
        '<joint stiffness="0.3"> in body link',
    )
    mass = Effect("body_mass", "body:link", (0.5,))
    (line,) = extend(nominal, nominal.start, [mass]).changes
    assert line.startswith("<inertial pos=")
    assert line.endswith("> in body link")


UNNAMED = """<mujoco>
<default>
<default class="visual"><geom contype="0"/></default>
<default class="collision"><geom group="3"/></default>
</default>
<worldbody>
<body name="a"><joint name="one" axis="0 1 0"/><geom class="visual" size=".1" mass="1"/>
<body name="b" pos="1 0 0"><joint name="two" axis="0 1 0"/>
<geom class="collision" size=".1" mass="1"/><site/><site pos="1 0 0"/></body></body>
</worldbody>
<contact><exclude body1="world" body2="a"/><exclude body1="a" body2="b"/></contact>
<tendon><fixed name="t"><joint joint="one" coef="1"/><joint joint="two" coef="2"/></fixed></tendon>
<sensor><jointpos joint="one"/><jointpos joint="two"/></sensor>
</mujoco>"""


def test_unnamed_neighbours_that_nothing_changes_are_not_listed():
    nominal = Nominal.of_model(UNNAMED, ParameterSpace(()))
    spring = Effect("joint_spring", "joint:one", (1.5,))
    assert extend(nominal, nominal.start, [spring]).changes == (
        '<joint name="one" stiffness="1.5">',
    )


def test_new_elements_are_told_by_name_and_without_what_mujoco_adds():
    nominal = arm()[1]
    load = Effect("body_load", "body:fore", (0.5, 0.0, 0.0, -0.2))
    body, inertial = extend(nominal, nominal.start, [load]).changes
    assert body == '<body name="adr_load_fore"> in body fore'
    assert (
        inertial == '<inertial pos="0 0 -0.4" mass="0.5" diaginertia="0 0 0"> in body adr_load_fore'
    )
    push = Effect("external_force", "body:fore", (0.1, 0.2, 0.3))
    world, site, force = extend(nominal, nominal.start, [push]).changes
    assert world == '<site name="adr_force_world"> in worldbody'
    assert site.startswith('<site name="adr_force_fore" pos=')
    assert force.startswith('<general name="adr_force_fore" site="adr_force_fore" refsite=')
    assert "limited" not in force


def test_an_effect_on_commands_stands_beside_the_model():
    nominal = arm()[1]
    extension = extend(nominal, nominal.start, [DELAY, SPRING])
    assert extension.beside == [DELAY]
    assert extension.to_json() == {
        "version": 1,
        "effects": [
            {"kind": "actuator_delay", "location": "actuator:elbow", "values": (0.01,)}
            | {"in_mjcf": False},
            {"kind": "joint_spring", "location": "joint:elbow", "values": (1 / 3,)}
            | {"in_mjcf": True},
        ],
    }


def test_mujoco_writes_its_own_digits_again_afterwards():
    xml = '<mujoco><worldbody><geom name="g" size="0.123456789"/></worldbody></mujoco>'
    spec = mujoco.MjSpec.from_string(xml)
    spec.compile()
    before = spec.to_xml()
    assert "0.123456789" in written_out(spec)
    assert spec.to_xml() == before
    assert "0.123456789" not in before


def test_an_extension_of_an_unknown_kind_is_refused():
    nominal = arm()[1]
    with pytest.raises(LookupError, match="no mechanism 'warp'"):
        extend(nominal, nominal.start, [Effect("warp", "global", (1.0,))])
