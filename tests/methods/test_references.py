"""The two references, which infer nothing and are part of every benchmark."""

import pytest

from adr_service.methods.base import Data
from adr_service.methods.catalogue import methods
from adr_service.methods.references import OracleSettings, PriorSettings

REFERENCES = (PriorSettings, OracleSettings)


def test_the_references_are_the_prior_and_the_oracle():
    given = [name for name, each in methods().items() if each.is_reference]
    assert given == ["prior", "oracle"]


@pytest.mark.parametrize("settings", REFERENCES)
def test_a_reference_learns_from_nothing(settings):
    nothing: Data = "nothing"
    assert settings.learns_from == nothing
    assert not settings().infers


def test_the_oracle_alone_needs_the_truth():
    assert [name for name, each in methods().items() if each.needs_truth] == ["oracle"]


def test_the_prior_is_an_estimate_and_the_oracle_is_not():
    """So that tables show the prior's distance from the truth, and no distance of the truth."""
    assert PriorSettings.believes
    assert not OracleSettings.believes
