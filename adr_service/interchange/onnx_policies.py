"""Policies as ONNX, for any runtime (onnxruntime, TensorRT, a microcontroller).

    path.write_bytes(to_onnx(policy, get_task("hopper"), {"run": "run_0123456789abcdef"}))

The graph has one input, `observation` (n, s), and one output, `action` (n, a) in the task's bounds,
both in float32. Its metadata have `observation_columns`, `action_columns` and `control_period_s`,
each as JSON.
"""

import json
from collections.abc import Mapping
from itertools import count
from typing import Any

import numpy as np

from adr_service.arrays import Vector
from adr_service.interchange.libraries import library
from adr_service.simulation.batch import control_period
from adr_service.simulation.model import action_names
from adr_service.tasks.base import Task
from adr_service.training.policy import Policy

_OPSET, _IR = 17, 8  # of 2022: read by every runtime of today
_ACTIVATIONS = {"relu": "Relu", "tanh": "Tanh"}


def to_onnx(policy: Policy, task: Task, about: Mapping[str, str]) -> bytes:
    """The bytes of a policy's ONNX file, with `about` in its metadata.

    The same numbers as `policy.act`, up to rounding in float32 (a test has 1e-6 of the bounds).
    """
    onnx = library("onnx")
    graph = _Graph(onnx)
    value = "observation"
    for weight, bias in policy.layers[:-1]:
        value = graph.add(_ACTIVATIONS[policy.activation], graph.affine(value, weight, bias))
    value = graph.affine(value, *policy.layers[-1])
    low, high = policy.action_low, policy.action_high
    scaled = graph.add("Mul", _squashed(graph, policy, value), graph.constant((high - low) / 2))
    action = graph.add("Add", scaled, graph.constant((high + low) / 2))
    least, most = _float32_within(low, high)
    action = graph.add("Max", action, graph.constant(least))  # rounding may lead beyond
    graph.add("Min", action, graph.constant(most), output="action")
    metadata = {
        "observation_columns": json.dumps(task.columns),
        "action_columns": json.dumps(action_names(task.xml)),
        "control_period_s": json.dumps(control_period(task)),
        **about,
    }
    return graph.to_bytes(policy.layers[0][0].shape[1], len(low), metadata)


def _float32_within(low: Vector, high: Vector) -> tuple[np.ndarray, np.ndarray]:
    """The least and the largest float32 within bounds (a,), which need not be float32."""
    least, most = low.astype(np.float32), high.astype(np.float32)
    least = np.where(least < low, np.nextafter(least, np.float32(np.inf)), least)
    return least, np.where(most > high, np.nextafter(most, np.float32(-np.inf)), most)


def _squashed(graph: "_Graph", policy: Policy, value: str) -> str:
    """The name of the last layer's outputs within [-1, 1], (n, a)."""
    if policy.squash == "tanh":
        return graph.add("Tanh", value)
    if policy.squash == "clip":
        return graph.add("Clip", value, graph.constant(-1.0), graph.constant(1.0))
    bins = len(policy.layers[-1][1]) // len(policy.action_low)
    shape = graph.integers([0, len(policy.action_low), bins])
    chances = graph.add("Softmax", graph.add("Reshape", value, shape), axis=2)
    return graph.add("MatMul", chances, graph.constant(np.linspace(-1, 1, bins)))


class _Graph:
    """Nodes and constants, which get their names as they come."""

    def __init__(self, onnx: Any):
        self._onnx, self._names = onnx, count()
        self._nodes: list[Any] = []
        self._constants: list[Any] = []

    def affine(self, value: str, weight: np.ndarray, bias: np.ndarray) -> str:
        return self.add("Gemm", value, self.constant(weight), self.constant(bias), transB=1)

    def add(self, kind: str, *inputs: str, output: str = "", **attributes: int) -> str:
        """Append a node; return the name of its output."""
        name = output or f"value_{next(self._names)}"
        self._nodes.append(self._onnx.helper.make_node(kind, inputs, [name], **attributes))
        return name

    def constant(self, values: Any) -> str:
        return self._constant(np.asarray(values, dtype=np.float32))

    def integers(self, values: list[int]) -> str:
        return self._constant(np.asarray(values, dtype=np.int64))

    def _constant(self, values: np.ndarray) -> str:
        name = f"constant_{next(self._names)}"
        self._constants.append(self._onnx.numpy_helper.from_array(values, name))
        return name

    def to_bytes(self, inputs: int, outputs: int, metadata: Mapping[str, str]) -> bytes:
        helper, kind = self._onnx.helper, self._onnx.TensorProto.FLOAT
        graph = helper.make_graph(
            self._nodes,
            "policy",
            [helper.make_tensor_value_info("observation", kind, ["n", inputs])],
            [helper.make_tensor_value_info("action", kind, ["n", outputs])],
            self._constants,
        )
        opset = [helper.make_opsetid("", _OPSET)]
        model = helper.make_model(
            graph, opset_imports=opset, ir_version=_IR, producer_name="adr_service"
        )
        helper.set_model_props(model, dict(metadata))
        self._onnx.checker.check_model(model)
        return model.SerializeToString()
