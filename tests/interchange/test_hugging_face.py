"""Policies as folders for the Hugging Face Hub."""

import json

import pytest
from huggingface_hub import ModelCard

from adr_service.errors import InvalidInput
from adr_service.interchange.hugging_face import write_model_folder
from adr_service.interchange.onnx_policies import to_onnx

ROWS = [
    {
        "iteration": i,
        "normalised_return": 0.5 * i,
        "policies": 1,
        "target_transitions": 200 * i,
        "episodes": 50,
    }
    for i in range(2)
]
SPEC = {
    "method": {"name": "dropo"},
    "variant": "vanilla",
    "seed": 3,
    "iterations": 1,
    "transitions": 200,
    "target": {"kind": "simulated"},
}


@pytest.fixture
def folder(policy, task, tmp_path):
    write_model_folder(tmp_path / "model", policy, task, SPEC, ROWS)
    return tmp_path / "model"


def test_the_card_has_the_hubs_metadata_and_the_return(folder, task):
    card = ModelCard.load(folder / "README.md")
    (result,) = card.data.eval_results
    assert result.metric_value == pytest.approx(0.5 * task.reward_threshold)
    assert card.data.pipeline_tag == "reinforcement-learning"
    assert "| 1 | 0.500 | 1 | 200 | 50 |" in card.text
    assert "seed 3, 1 iterations of 200 transitions" in card.text


def test_the_files_hold_the_same_policy(folder, policy, task):
    assert (folder / "policy.onnx").read_bytes() == to_onnx(
        policy, task, {"spec": json.dumps(SPEC)}
    )
    assert (folder / "policy.safetensors").read_bytes() == policy.to_bytes()
    assert json.loads((folder / "spec.json").read_text())["seed"] == 3


@pytest.mark.parametrize(
    ("method", "dynamics"),
    [
        ("dropo", "dynamics that `dropo` inferred from data of the target"),
        ("bayrn", "dynamics that `bayrn` chose by returns on the target"),
        ("udr", "dynamics that know nothing of the target (`udr`)"),
        ("oracle", "the target's own dynamics"),
    ],
)
def test_the_card_says_what_the_dynamics_come_from(policy, task, tmp_path, method, dynamics):
    spec = {**SPEC, "method": {"name": method}}
    write_model_folder(tmp_path / "card", policy, task, spec, ROWS)
    assert dynamics in " ".join((tmp_path / "card/README.md").read_text().split())


@pytest.mark.parametrize(
    ("method", "data"),
    [
        ("simopt", "seed 3, 1 iterations of 200 transitions of the target at most)"),
        ("bayrn", "seed 3, 1 iterations with full episodes on the target)"),
        ("udr", "seed 3)"),
    ],
)
def test_the_card_states_the_target_data_that_the_method_may_use(
    policy, task, tmp_path, method, data
):
    write_model_folder(tmp_path / "card", policy, task, {**SPEC, "method": {"name": method}}, ROWS)
    assert data in " ".join((tmp_path / "card/README.md").read_text().split())


def test_a_folder_with_something_in_it_is_refused(folder, policy, task):
    with pytest.raises(InvalidInput, match="not empty; name a new folder"):
        write_model_folder(folder, policy, task, SPEC, ROWS)


def test_a_run_on_a_recording_has_no_return(policy, task, tmp_path):
    spec = SPEC | {"target": {"kind": "recorded"}}
    write_model_folder(tmp_path / "model", policy, task, spec, [])
    card = ModelCard.load(tmp_path / "model/README.md")
    assert card.data.eval_results is None
    assert "evaluated on no target" in card.text
    assert "(variant `vanilla`, seed 3)" in card.text


def test_a_mean_over_policies_is_not_given_as_the_return_of_one(policy, task, tmp_path):
    spec = SPEC | {"method": {"name": "udr"}}
    write_model_folder(tmp_path / "model", policy, task, spec, [ROWS[0] | {"policies": 10}])
    card = ModelCard.load(tmp_path / "model/README.md")
    assert card.data.eval_results is None
    assert "know nothing of the target" in card.text
