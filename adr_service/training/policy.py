"""A trained policy: a deterministic actor that needs NumPy alone.

    policy = Policy.from_bytes(path.read_bytes())
    actions = policy.act(observations)      # (n, s) -> (n, a)

The bytes are a safetensors file: `layer_i.weight` (out, in) and `layer_i.bias` (out,) in
float32, and one JSON text under the metadata key `policy`. Never a pickle.
"""

import json
from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise
from typing import Any, Literal

import numpy as np
import safetensors.numpy
from safetensors import SafetensorError

from adr_service.arrays import Matrix, Vector, frozen
from adr_service.errors import InvalidInput

Squash = Literal["tanh", "clip", "bins"]
Layer = tuple[np.ndarray, np.ndarray]  # weight (out, in), bias (out,); float32


def _relu(x: np.ndarray) -> np.ndarray:
    return np.maximum(x, 0)


def _tanh(x: np.ndarray, actions: int) -> np.ndarray:
    return np.tanh(x)


def _clip(x: np.ndarray, actions: int) -> np.ndarray:
    return np.clip(x, -1, 1)


def _bins(x: np.ndarray, actions: int) -> np.ndarray:
    """The mean of evenly spaced values, from the logits of all bins (n, actions * bins)."""
    logits = x.reshape(len(x), actions, -1)
    with np.errstate(invalid="ignore"):  # NaN stays NaN
        probabilities = np.exp(logits - logits.max(axis=2, keepdims=True))
    probabilities /= probabilities.sum(axis=2, keepdims=True)
    return probabilities @ np.linspace(-1, 1, logits.shape[2], dtype=np.float32)


_ACTIVATIONS: dict[str, Callable[[np.ndarray], np.ndarray]] = {"relu": _relu, "tanh": np.tanh}
# from the last layer's outputs and the number of actions to actions in [-1, 1]
_SQUASHES: dict[Squash, Callable[[np.ndarray, int], np.ndarray]] = {
    "tanh": _tanh,
    "clip": _clip,
    "bins": _bins,
}
_UNREADABLE = (SafetensorError, KeyError, TypeError, ValueError, RecursionError, OverflowError)


def _numbers(tensor: np.ndarray) -> np.ndarray:
    """The tensor; raises InvalidInput unless it has finite numbers in float32."""
    if tensor.dtype != np.float32:
        raise InvalidInput(f"weights must be float32; there are {tensor.dtype}")
    if not np.isfinite(tensor).all():
        raise InvalidInput("weights must be finite; there are NaN or infinite ones")
    return tensor


@dataclass(frozen=True)
class Policy:
    """An actor without noise: an MLP of the observation, squashed and scaled to the action bounds.

    SAC and CrossQ: tanh (Haarnoja et al., arXiv 1801.01290, App. C: actions are tanh of a
    Gaussian). PPO: clipped, because its Gaussian has no bounds, or the mean of its bins.
    """

    layers: tuple[Layer, ...]
    activation: str  # between layers: "relu" or "tanh"
    action_low: Vector  # (a,)
    action_high: Vector  # (a,)
    squash: Squash = "tanh"  # to [-1, 1]

    def __post_init__(self) -> None:
        if self.activation not in _ACTIVATIONS:
            raise InvalidInput(
                f"activation must be one of {sorted(_ACTIVATIONS)}: {self.activation!r}"
            )
        if self.squash not in _SQUASHES:
            raise InvalidInput(f"squash must be one of {sorted(_SQUASHES)}: {self.squash!r}")
        if not self.layers or not len(self.action_low) == len(self.action_high) > 0:
            raise InvalidInput(
                "a policy needs a layer, and as many lower as upper bounds of actions: "
                f"{len(self.layers)} layers, {len(self.action_low)} lower and "
                f"{len(self.action_high)} upper bounds"
            )
        bounds = np.array([self.action_low, self.action_high])
        if bounds.ndim != 2 or not (np.isfinite(bounds).all() and (bounds[0] <= bounds[1]).all()):
            raise InvalidInput(
                f"bounds of actions must be finite numbers, the lower ones first; given {bounds}"
            )
        for weight, bias in self.layers:
            if weight.ndim != 2 or bias.shape != (len(weight),):
                raise InvalidInput(f"layers do not fit: {weight.shape} with {bias.shape}")
        bins, rest = divmod(len(self.layers[-1][1]), len(self.action_low))
        if rest or (bins < 2 if self.squash == "bins" else bins != 1):
            raise InvalidInput(
                f"{len(self.layers[-1][1])} outputs do not fit {len(self.action_low)} actions by "
                f"{self.squash!r}"
            )
        for (before, _), (after, _) in pairwise(self.layers):
            if after.shape[1] != before.shape[0]:
                raise InvalidInput(f"layers do not fit: {before.shape} then {after.shape}")

    def act(self, observations: Matrix) -> Matrix:
        """Actions (n, a) for observations (n, s)."""
        hidden = observations.astype(np.float32)
        activate = _ACTIVATIONS[self.activation]
        for weight, bias in self.layers[:-1]:
            hidden = activate(hidden @ weight.T + bias)
        weight, bias = self.layers[-1]
        unit = _SQUASHES[self.squash](hidden @ weight.T + bias, len(self.action_low))
        unit = unit.astype(np.float64)
        action = self.action_low + (unit + 1) / 2 * (self.action_high - self.action_low)
        return np.clip(action, self.action_low, self.action_high)  # rounding may lead beyond

    def to_bytes(self) -> bytes:
        """The policy's file; the same policy always gives the same bytes."""
        tensors: dict[str, np.ndarray] = {}
        for i, (weight, bias) in enumerate(self.layers):
            tensors[f"layer_{i}.weight"] = np.ascontiguousarray(weight)
            tensors[f"layer_{i}.bias"] = np.ascontiguousarray(bias)
        description: dict[str, Any] = {
            "activation": self.activation,
            "layers": len(self.layers),
            "action_low": self.action_low.tolist(),
            "action_high": self.action_high.tolist(),
        }
        if self.squash != "tanh":  # the only one at first, so it is not written
            description["squash"] = self.squash
        return safetensors.numpy.save(tensors, {"policy": json.dumps(description, sort_keys=True)})

    @classmethod
    def from_bytes(cls, content: bytes) -> "Policy":
        """The policy of a file that `to_bytes` made; raises InvalidInput for any other file."""
        try:
            tensors = safetensors.numpy.load(content)
            length = int.from_bytes(content[:8], "little")
            header = json.loads(content[8 : 8 + length])
            description = json.loads(header["__metadata__"]["policy"])
            layers = tuple(
                (
                    _numbers(tensors.pop(f"layer_{i}.weight")),
                    _numbers(tensors.pop(f"layer_{i}.bias")),
                )
                for i in range(description["layers"])
            )
            if tensors:
                raise InvalidInput(f"there are tensors beside its layers: {sorted(tensors)}")
            low, high = frozen(description["action_low"]), frozen(description["action_high"])
            squash = description.get("squash", "tanh")
            return cls(layers, description["activation"], low, high, squash)
        except (*_UNREADABLE, InvalidInput) as error:
            raise InvalidInput(
                "not the bytes of a policy, a safetensors file as `adr results RUN --policy FILE` "
                f"writes it ({error})"
            ) from error
