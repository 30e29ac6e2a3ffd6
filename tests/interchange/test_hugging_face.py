"""Policies as folders for the Hugging Face Hub."""

import json

import pytest
from huggingface_hub import ModelCard

from adr_service.errors import InvalidInput
from adr_service.interchange.hugging_face import write_model_folder
from adr_service.training.policy import Policy

ROWS = [
    {"iteration": i, "normalised_return": 0.5 * i, "target_transitions": 200 * i, "episodes": 50}
    for i in range(2)
]


@pytest.fixture
def folder(policy, task, tmp_path):
    spec = {
        "method": {"name": "dropo"},
        "variant": "vanilla",
        "seed": 3,
        "iterations": 1,
        "transitions": 200,
    }
    write_model_folder(tmp_path / "model", policy, task, spec, ROWS)
    return tmp_path / "model"


def test_the_card_has_the_hubs_metadata_and_the_return(folder, task):
    card = ModelCard.load(folder / "README.md")
    (result,) = card.data.eval_results
    assert result.metric_value == pytest.approx(0.5 * task.reward_threshold)
    assert card.data.pipeline_tag == "reinforcement-learning"
    assert "| 1 | 0.500 | 200 | 50 |" in card.text


def test_the_files_hold_the_same_policy(folder, policy):
    assert Policy.from_bytes((folder / "policy.safetensors").read_bytes()) is not policy
    assert (folder / "policy.safetensors").read_bytes() == policy.to_bytes()
    assert json.loads((folder / "spec.json").read_text())["seed"] == 3


def test_a_folder_with_something_in_it_is_refused(folder, policy, task):
    with pytest.raises(InvalidInput, match="is not empty"):
        write_model_folder(folder, policy, task, {}, ROWS)
