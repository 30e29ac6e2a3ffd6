"""Importing a leaf of the project brings along what it needs, and nothing heavy."""

import json

import pytest

from tests.packages import python

WATCHED = (
    *("cma", "fastapi", "gymnasium", "jax", "matplotlib", "mujoco", "numpy", "pydantic", "ray"),
    *("safetensors", "scipy", "sqlalchemy", "stable_baselines3", "torch"),
)
BROUGHT_ALONG = {
    "adr_service": set(),
    "adr_service.errors": set(),
    "adr_service.plugins": set(),
    "adr_service.presets": set(),
    "adr_service.startup_time": set(),
    "adr_service.arrays": {"numpy"},
    "adr_service.randomness": {"numpy"},
    "adr_service.parameters": {"numpy"},
    "adr_service.distributions": {"numpy"},
    "adr_service.search.cma_es": {"numpy"},
    "adr_service.json_values": {"pydantic"},
    "adr_service.events": {"pydantic"},
    "adr_service.progress": {"pydantic"},
    "adr_service.training.curve": {"pydantic"},
    "adr_service.training.settings": {"pydantic"},
    "adr_service.npz": {"numpy", "pydantic"},
    "adr_service.transitions": {"numpy", "pydantic"},
    "adr_service.tasks.catalogue": {"numpy", "pydantic"},
    "adr_service.training.policy": {"numpy", "safetensors"},
    "adr_service.simulation.model": {"mujoco", "numpy", "pydantic"},
    # the methods' settings stand beside their computations
    "adr_service.specs": {"mujoco", "numpy", "pydantic", "safetensors", "scipy"},
    # the service trains nothing itself
    "api.app": {
        *("fastapi", "gymnasium", "matplotlib", "mujoco", "numpy", "pydantic", "ray"),
        *("safetensors", "scipy", "sqlalchemy"),
    },
}


@pytest.mark.parametrize("module", BROUGHT_ALONG)
def test_a_leaf_imports_only_these_libraries(module):
    code = f"import json, sys, {module}; print(json.dumps(sorted(sys.modules)))"
    done = python(code)
    assert done.returncode == 0, done.stderr
    assert set(json.loads(done.stdout)) & set(WATCHED) == BROUGHT_ALONG[module]
