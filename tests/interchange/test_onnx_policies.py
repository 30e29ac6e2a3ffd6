"""Policies as ONNX, run by ONNX Runtime."""

import json
from dataclasses import replace

import numpy as np
import onnxruntime

from adr_service.interchange.onnx_policies import to_onnx


def test_another_runtime_acts_as_the_policy_does(policy, task, observations):
    session = onnxruntime.InferenceSession(to_onnx(policy, task, {}))
    (actions,) = session.run(None, {"observation": observations.astype(np.float32)})
    assert actions.shape == (len(observations), len(task.action_low))
    width = task.action_high - task.action_low
    assert np.max(np.abs(actions - policy.act(observations)) / width) < 1e-6


def test_the_file_says_what_its_columns_are(policy, task):
    session = onnxruntime.InferenceSession(to_onnx(policy, task, {"run": "run_1"}))
    about = session.get_modelmeta().custom_metadata_map
    assert json.loads(about["observation_columns"]) == list(task.columns)
    assert len(json.loads(about["action_columns"])) == len(task.action_low)
    assert all(json.loads(about["action_columns"]))
    assert json.loads(about["control_period_s"]) > 0
    assert about["run"] == "run_1"


def test_equal_policies_have_equal_files(policy, task):
    assert to_onnx(policy, task, {}) == to_onnx(policy, task, {})


def test_actions_lie_about_the_middle_of_uneven_bounds(policy, task, observations):
    uneven = replace(policy, action_low=policy.action_low / 2)
    session = onnxruntime.InferenceSession(to_onnx(uneven, task, {}))
    (actions,) = session.run(None, {"observation": observations.astype(np.float32)})
    np.testing.assert_allclose(actions, uneven.act(observations), atol=1e-6)
