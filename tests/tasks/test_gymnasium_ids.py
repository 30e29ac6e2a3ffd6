"""Gymnasium finds our tasks by their ids, whichever of the two is imported first."""

import gymnasium
import pytest

import adr_service
from adr_service.tasks.catalogue import BUILT_IN
from tests.packages import python

assert adr_service.__version__  # importing it registers the ids

MAKE = """
import sys
assert "mujoco" not in sys.modules, "registering needs no simulator"
env = gymnasium.make("adr/RandomHopper-v0")
print(env.unwrapped.space.names)
"""


@pytest.mark.parametrize("imports", ["gymnasium, adr_service", "adr_service, gymnasium"])
def test_ids_are_registered_in_either_order_of_imports_and_without_mujoco(imports):
    done = python(f"import {imports}\n{MAKE}")
    assert done.returncode == 0, done.stderr
    assert "torso_mass" in done.stdout


def test_ids_are_registered_after_somebody_has_looked_gymnasium_up():
    lookup = "import adr_service, importlib.util; importlib.util.find_spec('gymnasium')"
    done = python(f"{lookup}; import gymnasium; gymnasium.spec('adr/RandomArm-v0')")
    assert done.returncode == 0, done.stderr


def test_gymnasium_itself_imports_us_when_the_id_names_our_package():
    done = python("import gymnasium; print(gymnasium.make('adr_service:adr/RandomArm-v0'))")
    assert done.returncode == 0, done.stderr
    assert "adr/RandomArm-v0" in done.stdout


def test_importing_another_module_of_ours_first_registers_the_ids_too():
    done = python("import adr_service.errors, gymnasium; gymnasium.spec('adr/RandomArm-v0')")
    assert done.returncode == 0, done.stderr


def test_there_is_an_id_for_every_variant_of_every_task():
    ids = {name for name in gymnasium.registry if name.startswith("adr/")}
    robots = ("Arm", "Hopper", "HalfCheetah", "Walker2d", "Humanoid")
    suffixes = ("", "Noisy", "Unmodeled", "Edge", "Outside")
    assert ids == {f"adr/Random{robot}{suffix}-v0" for robot in robots for suffix in suffixes}


def test_an_id_has_its_tasks_horizon():
    for name, robot in (("arm", "Arm"), ("half_cheetah", "HalfCheetah")):
        spec = gymnasium.spec(f"adr/Random{robot}-v0")
        assert spec.max_episode_steps == BUILT_IN[name].task.horizon
