import pytest

from adr_service.errors import InvalidInput
from adr_service.json_values import sha256
from adr_service.programs import run
from adr_service.specs import CriticismSpec
from adr_service.stages.local import LocalStages
from tests.contracts.canned import CannedStages

SPEC = CriticismSpec.model_validate({"task": "arm", "dataset": "data_0"})


def test_a_criticism_is_one_stage_whose_files_are_named_by_their_hashes():
    stages = CannedStages()
    finished = list(run(SPEC, stages, b"measured"))[-1]
    ((kind, digest),) = stages.asked
    assert kind == "criticise"
    assert finished.files["verdict.json"] == sha256(digest.encode())
    assert finished.verdict == {"verdict": "none"}


def test_a_criticism_needs_its_data():
    with pytest.raises(InvalidInput, match="the data data_0 were not given"):
        list(run(SPEC, LocalStages()))
