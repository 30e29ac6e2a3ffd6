"""Policies: their bytes, their bounds, and files that are no policy."""

import json
import struct
from dataclasses import replace

import numpy as np
import pytest
import safetensors.numpy

from adr_service.errors import InvalidInput
from adr_service.training.policy import Policy
from tests.stages.examples import policy


@pytest.mark.parametrize("activation", ["relu", "tanh"])
def test_bytes_give_the_same_policy_and_the_same_bytes_back(activation):
    original = policy(activation=activation)
    copy = Policy.from_bytes(original.to_bytes())
    observations = np.random.default_rng(1).normal(size=(6, 4))
    np.testing.assert_array_equal(copy.act(observations), original.act(observations))
    assert copy.to_bytes() == original.to_bytes()


def test_actions_stay_within_their_bounds():
    actions = policy().act(100 * np.random.default_rng(1).normal(size=(1000, 4)))
    assert np.all((actions >= [-1, -2]) & (actions <= [1, 4]))
    assert actions.min(axis=0) == pytest.approx([-1, -2])


def described(text):
    """A file without layers, with this description."""
    return safetensors.numpy.save({"x": np.zeros(1, np.float32)}, {"policy": text})


def altered(**tensors):
    """A policy's file with these tensors in the place of its own, or beside them."""
    content = policy().to_bytes()
    whole = safetensors.numpy.load(content)
    header = json.loads(content[8 : 8 + int.from_bytes(content[:8], "little")])
    named = {name.replace("__", "."): tensor for name, tensor in tensors.items()}
    return safetensors.numpy.save({**whole, **named}, header["__metadata__"])


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (altered(layer_0__bias=np.full(8, np.nan, np.float32)), "weights must be finite"),
        (altered(layer_0__bias=np.zeros(8, np.int64)), "float32; there are int64"),
        (altered(layer_7__bias=np.zeros(8, np.float32)), r"beside its layers: \['layer_7.bias'\]"),
        (policy().to_bytes().replace(b'\\"layers\\": 3', b'\\"layers\\": 1'), "beside its layers"),
    ],
    ids=["not finite", "integers", "another tensor", "fewer layers"],
)
def test_layers_of_other_numbers_and_other_tensors_are_refused(content, message):
    with pytest.raises(InvalidInput, match=message):
        Policy.from_bytes(content)


@pytest.mark.parametrize(
    "content",
    [
        b"",
        b"nonsense",
        struct.pack("<Q", 2**40) + b"{}",
        struct.pack("<Q", 2) + b"{}",
        policy().to_bytes()[:-7],
        policy().to_bytes().replace(b'\\"layers\\": 3', b'\\"layers\\": 0'),
        described('"[' + "[" * 200_000),
        described('{"activation": "relu", "layers": 0, "action_low": [1e999]}'),
        described(f'{{"activation": "relu", "layers": 0, "action_low": [{10**400}]}}'),
    ],
    ids=[
        *("empty", "nonsense", "huge header", "no tensors", "truncated", "no layers"),
        *("nested without end", "no number", "a huge number"),
    ],
)
def test_bytes_of_anything_else_are_refused(content):
    with pytest.raises(InvalidInput, match="not the bytes of a policy"):
        Policy.from_bytes(content)


def test_bins_give_the_mean_of_evenly_spaced_values():
    """Two actions with three values each; their bounds are -1 and 1, and -2 and 4."""
    chances = np.array([0.1, 0.2, 0.7, 0.25, 0.5, 0.25], np.float32)
    layer = (np.zeros((6, 4), np.float32), np.log(chances) + np.float32(3))
    mean = Policy((layer,), "relu", np.array([-1.0, -2.0]), np.array([1.0, 4.0]), "bins")
    copy = Policy.from_bytes(mean.to_bytes())
    np.testing.assert_allclose(copy.act(np.zeros((5, 4))), np.tile([0.6, 1.0], (5, 1)), rtol=1e-6)
    assert np.isnan(copy.act(np.full((1, 4), np.nan))).all()


@pytest.mark.parametrize(
    ("outputs", "squash"), [(3, "tanh"), (4, "clip"), (2, "bins"), (5, "bins")]
)
def test_outputs_that_do_not_fit_the_actions_are_refused(outputs, squash):
    layer = (np.zeros((outputs, 4), np.float32), np.zeros(outputs, np.float32))
    with pytest.raises(InvalidInput, match=f"{outputs} outputs do not fit 2 actions"):
        Policy((layer,), "relu", np.full(2, -1.0), np.ones(2), squash)


def test_layers_that_do_not_fit_are_refused():
    layers = policy().layers
    with pytest.raises(InvalidInput, match="do not fit"):
        Policy((layers[0], layers[0]), "relu", np.zeros(2), np.ones(2))


def test_a_policys_file_can_be_read_without_our_code():
    content = policy().to_bytes()
    (length,) = struct.unpack("<Q", content[:8])
    header = json.loads(content[8 : 8 + length])
    assert json.loads(header["__metadata__"]["policy"])["activation"] == "relu"
    assert header["layer_0.weight"] == {
        "dtype": "F32",
        "shape": [8, 4],
        "data_offsets": header["layer_0.weight"]["data_offsets"],
    }


def test_a_policy_is_the_tanh_of_its_network_scaled_to_the_bounds():
    weight, bias = np.array([[2.0, 0.0], [0.0, -1.0]], np.float32), np.zeros(2, np.float32)
    single = Policy(((weight, bias),), "relu", np.array([-1.0, -2.0]), np.array([1.0, 4.0]))
    actions = single.act(np.array([[0.3, 0.5]]))
    np.testing.assert_allclose(actions[0], [np.tanh(0.6), 1 + 3 * np.tanh(-0.5)], rtol=1e-6)


@pytest.mark.parametrize(
    ("low", "high"),
    [([3.0, 0.0], [1.0, 1.0]), ([np.nan, 0.0], [1.0, 1.0]), ([[0.0], [0.0]], [[1.0], [1.0]])],
)
def test_bounds_between_which_no_action_lies_are_refused(low, high):
    with pytest.raises(InvalidInput, match="bounds of actions must be finite numbers"):
        replace(policy(), action_low=np.array(low), action_high=np.array(high))


def test_an_unknown_activation_is_refused_with_the_known_ones():
    with pytest.raises(InvalidInput, match=r"one of \['relu', 'tanh'\]: 'elu'"):
        policy(activation="elu")
