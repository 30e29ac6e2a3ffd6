"""A simulator extended by what it lacks: as a source of policies, and what that is worth."""

from dataclasses import replace

import mujoco
import numpy as np
import pytest

from adr_service.criticism.nominal import Nominal
from adr_service.effects.base import Effect, domain_of
from adr_service.errors import InvalidInput
from adr_service.parameters import Parameter, ParameterSpace
from adr_service.programs import run
from adr_service.simulation.batch import Simulations
from adr_service.specs import RunSpec
from adr_service.stages.local import LocalStages
from adr_service.tasks.arm import Arm
from adr_service.tasks.base import Source
from adr_service.tasks.catalogue import get_task, source_of
from tests.hidden import named_effects

EFFECTS = {
    "arm": (
        Effect("joint_spring", "joint:elbow", (3.0,)),
        Effect("payload", "body:fore", (0.3,)),  # on top of a mass that is a parameter
        Effect("joint_asymmetric_viscous_friction", "joint:shoulder", (0.5,)),
        Effect("external_force", "body:fore", (1.0, 0.0, 2.0)),
        Effect("body_mass", "body:upper", (0.5,)),  # of a body whose inertia scales with its mass
    ),
    "hopper": (
        Effect("joint_coulomb_friction", "joint:leg_joint", (4.0,)),
        Effect("gravity_tilt", "global", (0.05, 0.0)),
    ),
}


HEAVIER = (Effect("body_mass", "body:upper", (0.5,)),)  # alone: its inertia is a parameter's


@pytest.mark.parametrize(("name", "effects"), [*EFFECTS.items(), ("arm", HEAVIER)])
def test_extended_simulations_equal_mujoco_with_the_extended_model(name, effects):
    check_against_mujoco(get_task(name), source_of(name, domain_of("vanilla", effects)))


def check_against_mujoco(task, source):
    effects, rng, n = source.effects, np.random.default_rng(0), 3
    simulations = Simulations(task, source, n)
    draws = np.array([[rng.uniform(p.high / 2, p.high) for p in source.space.parameters]] * n)
    draws[1:] *= rng.uniform(0.8, 1.0, (n - 1, draws.shape[1]))
    start = task.initial(n, rng)
    actions = rng.uniform(-0.5, 0.5, (20, n, len(task.action_low)))
    simulations.set_dynamics(np.ones_like(draws))  # another draw before leaves nothing behind
    simulations.set_dynamics(draws)
    simulations.set_state(start)
    for action in actions:
        simulations.step(action)
    for i in range(n):
        model = Nominal(task.xml, source.space, draws[i]).model(draws[i], effects)
        data = mujoco.MjData(model)
        data.qpos[:], data.qvel[:] = start.qpos[i], start.qvel[i]
        for action in actions[:, i]:
            data.ctrl[: len(action)] = action
            mujoco.mj_step(model, data, task.frame_skip)
        np.testing.assert_array_equal(simulations.state.qpos[i], data.qpos)
        np.testing.assert_array_equal(simulations.state.qvel[i], data.qvel)


class Drives(Arm):
    """The arm with a drive that has a bias, zero in the file, and one that has no name."""

    @property
    def xml(self):
        affine = '<general name="shoulder" joint="shoulder" gear="35" biastype="affine"/>'
        return (
            super()
            .xml.replace('<motor name="shoulder" joint="shoulder" gear="35"/>', affine)
            .replace('<motor name="elbow"', "<motor")
        )


def test_effects_in_drives_act_on_drawn_biases_and_where_a_file_gives_no_name():
    weak = [Effect("actuator_gain", f"actuator:{a}", (-0.5,)) for a in ("shoulder", "unnamed_1")]
    bias = Parameter("bias", "actuator:shoulder.bias", "", 0.0, 0.2, 0.0)
    check_against_mujoco(Drives(), Source(ParameterSpace((bias,)), effects=tuple(weak)))


@pytest.mark.parametrize(
    ("effect", "message"),
    [
        (("actuator_delay", "actuator:elbow", [0.01]), "acts on commands or in sensors"),
        (("joint_spring", "joint:knee", [1.0]), "knee"),
        (("joint_coulomb_friction", "joint:elbow", [-1.0]), "0 at least; given"),
        (("joint_spring", "joint:elbow", [1.0, 2.0]), "takes stiffness"),
        (("warp_drive", "global", [1.0]), "warp_drive"),
        (("body_mass", "body:fore", [-50.0]), "negative mass"),
    ],
)
@pytest.mark.parametrize("where", ["extension", "target"])
def test_effects_that_no_training_can_simulate_are_refused(effect, message, where):
    given = [dict(zip(("kind", "location", "values"), effect, strict=True))]
    fields = (
        {"extension": given}
        if where == "extension"
        else {"target": {"kind": "simulated", "effects": given}}
    )
    with pytest.raises(ValueError, match=message):
        RunSpec.model_validate({"task": "arm", "method": "prior", "preset": "smoke", **fields})


@pytest.mark.parametrize(
    ("variant", "mass"),
    [
        ("vanilla", -1.0),  # of 3.5 kg in the file, and of 0.1 kg at least in a draw
        ("unmodeled", -3.0),  # of 2.8 kg in all draws
    ],
)
def test_effects_that_leave_no_mass_in_some_draw_are_refused(variant, mass):
    lighter = {"kind": "body_mass", "location": "body:torso", "values": [mass]}
    given = {"task": "hopper", "variant": variant, "method": "prior", "preset": "smoke"}
    with pytest.raises(ValueError, match="leave torso with a negative mass"):
        RunSpec.model_validate({**given, "extension": [lighter]})
    RunSpec.model_validate({**given, "extension": [{**lighter, "values": [mass / 20]}]})


def test_a_variant_names_no_effects_of_its_own():
    given = {"task": "arm", "method": "prior", "preset": "smoke"}
    with pytest.raises(ValueError, match="variant of arm"):
        RunSpec.model_validate({**given, "variant": domain_of("vanilla", EFFECTS["arm"])})


def test_what_a_robot_would_feel_in_its_observations_is_refused():
    source = source_of("humanoid", "vanilla")
    push = (Effect("external_force", "body:torso", (5.0, 0.0, 0.0)),)
    with pytest.raises(InvalidInput, match="observes its actuators"):
        Simulations(get_task("humanoid"), replace(source, effects=push), 1)


def test_a_body_that_would_shift_the_columns_of_an_observation_is_refused():
    """The reward of Humanoid found another body's numbers where its own progress had been."""
    source = source_of("humanoid", "vanilla")
    load = (Effect("body_load", "body:torso", (1.0, 0.0, 0.0, 0.0)),)
    with pytest.raises(InvalidInput, match=r"observes cinert, cvel, cfrc_ext, .* its bodies"):
        Simulations(get_task("humanoid"), replace(source, effects=load), 1)


def test_lengths_cannot_be_combined_with_effects():
    source = source_of("walker2d", "vanilla")
    spring = (Effect("joint_spring", "joint:leg_joint", (1.0,)),)
    with pytest.raises(InvalidInput, match="compiled anew for every draw"):
        Simulations(get_task("walker2d"), replace(source, effects=spring), 1)


@pytest.mark.parametrize(
    ("method", "knows"), [("oracle", True), ("prior", False), ("simopt", False), ("dropo", False)]
)
def test_the_oracle_knows_the_hidden_effects_and_no_method_does(method, knows):
    hidden = [{"kind": "joint_spring", "location": "joint:elbow", "values": [3.0]}]
    target = {"kind": "simulated", "effects": hidden}
    given = {"task": "arm", "method": method, "preset": "smoke", "target": target}
    stages = LocalStages()
    assert list(run(RunSpec.model_validate(given), stages))
    for stage in stages.executed:
        is_target = stage.kind in ("target_rollout", "target_return", "evaluate")
        assert ("joint_spring" in str(stage.inputs)) == (is_target or knows)
    assert {stage.kind for stage in stages.executed} >= {"train_policy", "evaluate"}


@pytest.mark.slow
def test_what_the_unmodeled_variant_has_wrong_is_named():
    """The torso's mass is frozen at 0.8 of its truth."""
    (named,) = named_effects("hopper", "unmodeled", [], seed=5)
    assert (named["kind"], named["location"]) == ("body_mass", "body:torso")
    wrong = source_of("hopper", "unmodeled").fixed["body:torso.mass"]
    assert named["values"][0] == pytest.approx(0.25 * wrong, rel=0.01)
