"""Versions and CPU type of this process."""

import numpy as np
import pytest

from adr_service.provenance import cpu_type, has_same_provenance, provenance


def test_the_provenance_names_versions_and_the_cpu():
    facts = provenance()
    assert facts["numpy"] == np.__version__
    assert facts["cpu"]
    assert facts == provenance()


def test_the_libraries_of_trainings_and_of_searches_are_named():
    """Two of them have an underscore in their package's own name."""
    names = {"stable-baselines3", "sb3-contrib", "torch", "botorch", "gpytorch", "scipy", "cma"}
    assert names <= set(provenance())


def test_the_libraries_that_compile_and_update_sbx_are_named():
    pytest.importorskip("sbx")
    assert {"sbx-rl", "jax", "jaxlib", "flax", "optax"} <= set(provenance())


def test_a_package_that_pip_left_half_installed_is_passed_over(tmp_path, monkeypatch):
    (tmp_path / "broken-1.0.dist-info").mkdir()
    monkeypatch.syspath_prepend(tmp_path)
    assert "numpy" in provenance()


def test_only_what_was_noted_with_a_result_is_compared():
    here = {"cpu": "AMD EPYC", "numpy": "2.4.6", "botorch": "0.18.1"}
    older = {"cpu": "AMD EPYC", "numpy": "2.4.6"}
    assert has_same_provenance(here, here)
    assert has_same_provenance(older, here)
    assert not has_same_provenance({**older, "numpy": "2.4.5"}, here)
    assert not has_same_provenance({**older, "sbi": "0.27.0"}, here)
    assert not has_same_provenance({}, here)


def test_two_generations_of_cpus_with_one_name_are_two_types():
    """Policies trained on them differ, because compiled programs do."""
    text = "processor : 0\nmodel name : AMD EPYC\ncpu family : 25\nmodel : 17\n\nprocessor : 1\n"
    assert cpu_type(text) == "AMD EPYC, family 25, model 17"
    assert cpu_type(text) != cpu_type(text.replace("model : 17", "model : 1"))
    assert cpu_type("processor : 0\nmodel name : Neoverse\n") == "Neoverse"
