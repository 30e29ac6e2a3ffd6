"""Policies as ONNX, run by ONNX Runtime."""

import json
from dataclasses import replace

import numpy as np
import onnxruntime
import pytest

from adr_service.interchange.onnx_policies import to_onnx


def test_another_runtime_acts_as_the_policy_does(policy, task, observations):
    session = onnxruntime.InferenceSession(to_onnx(policy, task, {}))
    (actions,) = session.run(None, {"observation": observations.astype(np.float32)})
    assert actions.shape == (len(observations), len(task.action_low))
    width = task.action_high - task.action_low
    assert np.max(np.abs(actions - policy.act(observations)) / width) < 1e-6


def test_no_action_is_beyond_bounds_that_float32_does_not_have(policy, task, observations):
    """The float32 next to .4 is above it: a robot's side that checks its bounds would refuse it."""
    width = len(policy.action_low)
    *before, (weight, bias) = policy.layers
    for sign in (-1, 1):
        layers = (*before, (weight, bias + np.float32(1e6 * sign)))
        bound = replace(
            policy,
            layers=layers,
            action_low=np.full(width, -0.4),
            action_high=np.full(width, 0.4),
        )
        session = onnxruntime.InferenceSession(to_onnx(bound, task, {}))
        (actions,) = session.run(None, {"observation": observations.astype(np.float32)})
        assert np.all(np.abs(actions.astype(float)) <= 0.4)
        np.testing.assert_allclose(actions, bound.act(observations), atol=1e-6)


def test_the_file_says_what_its_columns_are(policy, task):
    session = onnxruntime.InferenceSession(to_onnx(policy, task, {"run": "run_1"}))
    about = session.get_modelmeta().custom_metadata_map
    assert json.loads(about["observation_columns"]) == list(task.columns)
    assert len(json.loads(about["action_columns"])) == len(task.action_low)
    assert all(json.loads(about["action_columns"]))
    period = {"arm": 0.02, "humanoid": 0.015}[task.name]
    assert json.loads(about["control_period_s"]) == pytest.approx(period)
    assert about["run"] == "run_1"


def test_equal_policies_have_equal_files(policy, task):
    assert to_onnx(policy, task, {}) == to_onnx(policy, task, {})


def test_actions_lie_about_the_middle_of_uneven_bounds(policy, task, observations):
    uneven = replace(policy, action_low=policy.action_low / 2)
    session = onnxruntime.InferenceSession(to_onnx(uneven, task, {}))
    (actions,) = session.run(None, {"observation": observations.astype(np.float32)})
    np.testing.assert_allclose(actions, uneven.act(observations), atol=1e-6)
