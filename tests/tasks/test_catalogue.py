"""The catalogue collects our tasks from their files and explains names that it does not have."""

import numpy as np
import pytest

from adr_service.errors import UnknownName
from adr_service.tasks.catalogue import (
    BUILT_IN,
    catalogue,
    get_task,
    hidden_of,
    source_of,
    task_inputs,
    variant_of,
)
from tests.packages import python

CART = '''
from dataclasses import dataclass, field

import numpy as np

from adr_service.arrays import Vector, frozen
from adr_service.parameters import Parameter, ParameterSpace
from adr_service.tasks.base import Entry, State, benchmark_variants, freeze

_SPACE = ParameterSpace((
    Parameter("mass", "body:cart.mass", "kg", 0.5, 5.0, 0.1),
    Parameter("friction", "joint:x.damping", "N s/m", 0.0, 2.0, 0.0),
))
_XML = """<mujoco><option timestep="0.01"><flag warmstart="disable" autoreset="disable"/></option>
<worldbody><body name="cart"><joint name="x" type="slide" axis="1 0 0"/>
<geom size=".1" mass="1"/></body></worldbody>
<actuator><motor joint="x" ctrlrange="-1 1"/></actuator></mujoco>"""


@dataclass(frozen=True)
class Cart:
    name: str = "cart"
    xml: str = _XML
    frame_skip: int = 2
    columns: tuple[str, ...] = ("x [m]", "x_velocity [m/s]")
    measured: int = 2
    derived: tuple[str, ...] = ()
    action_low: Vector = field(default_factory=lambda: frozen([-1.0]))
    action_high: Vector = field(default_factory=lambda: frozen([1.0]))
    horizon: int = 50
    reward_threshold: float = 40.0
    learning_rate: float = 1e-3

    def initial(self, n, rng):
        return State(rng.uniform(-1, 1, (n, 1)), np.zeros((n, 1)))

    def observe(self, state):
        return np.concatenate([state.qpos, state.qvel], axis=1)

    def state(self, observations):
        return State(observations[:, :1], observations[:, 1:])

    def reward(self, before, action, after):
        return np.exp(-after.qpos[:, 0] ** 2)

    def terminated(self, state):
        return np.zeros(len(state.qpos), dtype=bool)


_TRUTH = (1.5, 0.4)
ENTRY = Entry(Cart(), benchmark_variants(_SPACE, _TRUTH, 1e-4, freeze(_SPACE, _TRUTH, ["mass"])))
'''

RUN = """
import sys
import adr_service.tasks
adr_service.tasks.__path__.append(FOLDER)

from adr_service.stages.local import LocalStages
from adr_service.programs import run
from adr_service.specs import RunSpec
from adr_service.tasks.catalogue import BUILT_IN, task_inputs
from adr_service.tasks.check import check_task

assert list(BUILT_IN) == ["cart", "arm", "hopper", "half_cheetah", "walker2d", "humanoid"]
assert task_inputs("cart") == {"task": "cart"}
check_task(BUILT_IN["cart"])
spec = {"task": "cart", "method": {"name": "simopt", "samples": 10}, "preset": "smoke"}
events = list(run(RunSpec.model_validate(spec), LocalStages()))
assert events[-1].type == "iteration_finished"
print("fine")
"""


def test_a_task_is_added_by_one_file_and_runs(tmp_path):
    (tmp_path / "cart.py").write_text(CART)
    done = python(f"FOLDER = {str(tmp_path)!r}\n{RUN}")
    assert done.returncode == 0, done.stderr
    assert done.stdout.strip() == "fine"


def test_our_tasks_come_first_and_those_with_few_parameters_before_the_others():
    ours = ["arm", "hopper", "half_cheetah", "walker2d", "humanoid"]
    assert list(BUILT_IN) == list(catalogue())[:5] == ours


def test_every_name_leads_to_the_task_of_that_name():
    for name, entry in BUILT_IN.items():
        assert get_task(name) is entry.task
        assert entry.task.name == name
        assert variant_of(name, "noisy") is entry.variants["noisy"]


def test_an_unknown_task_or_variant_is_answered_with_the_known_ones():
    with pytest.raises(UnknownName, match="did you mean 'hopper'"):
        get_task("hoper")
    with pytest.raises(UnknownName, match="vanilla, noisy, unmodeled"):
        source_of("arm", "windy")


def test_the_effects_of_a_domain_are_added_to_source_and_truth():
    effect = '{"kind":"joint_spring","location":"joint:elbow","values":[2.0]}'
    domain = f"vanilla@[{effect}]"
    for source in (source_of("arm", domain), hidden_of("arm", domain).source):
        assert source.space == source_of("arm", "vanilla").space
        assert "joint_spring" in repr(source)
    np.testing.assert_array_equal(
        hidden_of("arm", domain).values, hidden_of("arm", "vanilla").values
    )


def test_a_task_of_ours_is_identified_by_its_name_alone():
    assert task_inputs("hopper") == {"task": "hopper"}
