"""Policies as folders for the Hugging Face Hub."""

import json

import pytest
from huggingface_hub import ModelCard

from adr_service.errors import InvalidInput
from adr_service.interchange.hugging_face import write_model_folder
from adr_service.interchange.onnx_policies import to_onnx
from adr_service.specs import RunSpec

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


def spec_of(task, method="dropo", **changes):
    """A run's spec as the service gives it."""
    given = {"task": task.name, "method": method, "preset": "smoke", "seed": 3}
    run = RunSpec.model_validate({**given, "iterations": 1, "transitions": 200, **changes})
    return run.model_dump(mode="json")


@pytest.fixture
def folder(policy, task, tmp_path):
    write_model_folder(tmp_path / "model", policy, task, spec_of(task), ROWS)
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
        policy, task, {"spec": json.dumps(spec_of(task))}
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
    write_model_folder(tmp_path / "card", policy, task, spec_of(task, method), ROWS)
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
    write_model_folder(tmp_path / "card", policy, task, spec_of(task, method), ROWS)
    assert data in " ".join((tmp_path / "card/README.md").read_text().split())


def test_the_card_says_that_a_robot_was_the_target_and_what_its_simulator_was_extended_by(
    policy, task, tmp_path
):
    """A return on a robot was published as one on the simulated task."""
    joint = {"arm": "joint:elbow", "humanoid": "joint:right_knee"}[task.name]
    spring = {"kind": "joint_spring", "location": joint, "values": [1.0]}
    spec = spec_of(task, target={"kind": "external"}, extension=[spring], collector="random")
    write_model_folder(tmp_path / "card", policy, task, spec, ROWS)
    card, told = ModelCard.load(tmp_path / "card/README.md"), f"joint_spring at {joint}, external"
    (result,) = card.data.eval_results
    assert f"vanilla, extended by {told} target" in result.dataset_name
    assert f"# {task.name}, dropo on random, extended by {told} target" in card.text
    assert told in card.text.split("(variant")[1]


def test_a_spec_that_cannot_be_read_here_is_refused_in_words(policy, task, tmp_path):
    """As of a service that has a method of a package that is missing here."""
    spec = spec_of(task) | {"method": {"name": "bristles"}}
    with pytest.raises(InvalidInput, match=r"spec cannot be read here: .*bristles"):
        write_model_folder(tmp_path / "card", policy, task, spec, ROWS)


def test_a_folder_with_something_in_it_is_refused(folder, policy, task):
    with pytest.raises(InvalidInput, match="not empty; name a new folder"):
        write_model_folder(folder, policy, task, spec_of(task), ROWS)


def test_a_run_on_a_recording_has_no_return(policy, task, tmp_path):
    recording = {"kind": "recorded", "dataset": "data_0123456789abcdef"}
    spec = spec_of(task, target=recording, collector="recording")
    write_model_folder(tmp_path / "model", policy, task, spec, [])
    card = ModelCard.load(tmp_path / "model/README.md")
    assert card.data.eval_results is None
    assert "evaluated on no target" in card.text
    assert "(variant `vanilla`, seed 3, recorded target)" in card.text


def test_a_mean_over_policies_is_not_given_as_the_return_of_one(policy, task, tmp_path):
    rows = [ROWS[0] | {"policies": 10}]
    write_model_folder(tmp_path / "model", policy, task, spec_of(task, "udr"), rows)
    card = ModelCard.load(tmp_path / "model/README.md")
    assert card.data.eval_results is None
    assert "know nothing of the target" in card.text
