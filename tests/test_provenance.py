"""Versions and CPU type of this process."""

import numpy as np

from adr_service.provenance import cpu_type, provenance


def test_the_provenance_names_versions_and_the_cpu():
    facts = provenance()
    assert facts["numpy"] == np.__version__
    assert facts["cpu"]
    assert facts == provenance()


def test_two_generations_of_cpus_with_one_name_are_two_types():
    """Policies trained on them differ, because compiled programs do."""
    text = "processor : 0\nmodel name : AMD EPYC\ncpu family : 25\nmodel : 17\n\nprocessor : 1\n"
    assert cpu_type(text) == "AMD EPYC, family 25, model 17"
    assert cpu_type(text) != cpu_type(text.replace("model : 17", "model : 1"))
    assert cpu_type("processor : 0\nmodel name : Neoverse\n") == "Neoverse"
