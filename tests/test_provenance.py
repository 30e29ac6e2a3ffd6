"""Versions and CPU type of this process."""

import numpy as np

from adr_service.provenance import provenance


def test_the_provenance_names_versions_and_the_cpu():
    facts = provenance()
    assert facts["numpy"] == np.__version__
    assert facts["cpu"]
    assert facts == provenance()
