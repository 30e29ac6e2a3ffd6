"""Stored results against the same stages computed here and now.

    for stage in sampled(replays, 5, rng, is_comparable):
        verified = verify(stage, stored, is_same_machine)
        verified.agreement              # identical, close or different

Where versions and CPU type are those of the stored result, every byte must be equal. Elsewhere
numbers must agree up to `tolerance`, of an evaluation the mean return: a long episode is chaotic.
Measured on 30 evaluations of trained Hoppers that another type of AMD EPYC had computed, 100
episodes each: mean returns differ by 1.2e-4 at most, single returns by 6.5e-3 at most and 1e-8 in
the median. SimOpt compares such episodes and updates by them: of eleven of its inferences on Hopper
one differed by 2.1e-3, in a mean in [0, 4], another by 2.3e-3, in a temperature, and the rest by
2.9e-4 at most. What the search of an inference took is not compared: whole numbers, the path and
how it ended. One of least squares ended after 195 replays in place of 198, with an answer equal to
1e-9. A training takes another path there, as with another seed, so trainings can only be compared
on the CPU type that they were computed on.
"""

import heapq
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal, cast

import numpy as np
from numpy.typing import NDArray
from safetensors import SafetensorError
from safetensors.numpy import load

from adr_service.benchmark.replay import Replay
from adr_service.json_values import canonical_json
from adr_service.npz import names_in, read_arrays
from adr_service.stages.base import AnyStage, StageResult, compute
from adr_service.stages.evaluate import Evaluate
from adr_service.stages.infer import Infer

_SEARCH_DETAILS = (["diagnostics", "path"], ["diagnostics", "stopped_by"])  # DROPO's and DROID's
TOLERANCE, INFERENCE_TOLERANCE = 1e-3, 1e-2  # of a difference of numbers, over max(1, their size)
Agreement = Literal["identical", "close", "different"]


@dataclass(frozen=True)
class Verified:
    """A stage that was computed again."""

    kind: str
    digest: str
    agreement: Agreement
    deviation: float  # the largest of its numbers; infinite where the form differs
    seconds: float  # that it took here


def sampled(
    replays: Iterable[Replay],
    count: int,
    rng: np.random.Generator,
    is_comparable: Callable[[AnyStage], bool],
) -> list[AnyStage]:
    """Draw `count` different stages of runs without replacement, or all if there are fewer."""
    drawn: list[tuple[float, str, AnyStage]] = []
    seen: set[str] = set()
    for replay in replays:
        for stage in replay.stages:
            if stage.digest not in seen and is_comparable(stage):
                heapq.heappush(drawn, (rng.random(), stage.digest, stage))
                if len(drawn) > count:
                    heapq.heappop(drawn)
            seen.add(stage.digest)
    return [stage for _, _, stage in sorted(drawn, key=lambda entry: entry[1])]


def verify(stage: AnyStage, stored: StageResult, is_same_machine: bool) -> Verified:
    """Compute a stage again, and compare its result with the stored one."""
    started = time.monotonic()
    computed = compute(stage)
    seconds = time.monotonic() - started
    agreement: Agreement = "different"
    if _is_identical(stored, computed):
        agreement, deviation = "identical", 0.0
    else:
        deviation = _deviation(stage.kind, stored, computed)
        if not is_same_machine and deviation <= tolerance(stage.kind):
            agreement = "close"
    return Verified(stage.kind, stage.digest, agreement, deviation, seconds)


def tolerance(kind: str) -> float:
    """Largest deviation of a result that another type of CPU computed."""
    return INFERENCE_TOLERANCE if kind == Infer.kind else TOLERANCE


def _is_identical(stored: StageResult, computed: StageResult) -> bool:
    equal = canonical_json(stored.values) == canonical_json(computed.values)
    return equal and stored.blobs == computed.blobs


def _deviation(kind: str, stored: StageResult, computed: StageResult) -> float:
    """The largest difference of two numbers in the same place."""
    if stored.blobs.keys() != computed.blobs.keys():
        return float("inf")
    values = (_compared(kind, each.values) for each in (stored, computed))
    differences = [_difference(*values)]
    for name, content in stored.blobs.items():
        differences.append(_difference(_arrays(content), _arrays(computed.blobs[name])))
    return max(differences)


def _compared(kind: str, values: Mapping[str, Any]) -> dict[str, Any]:
    """The leaves by their paths, without what an inference's search took: rounding ends it."""
    leaves = _plain(_reported(kind, values))
    if kind != Infer.kind:
        return leaves
    return {
        name: value
        for name, value in leaves.items()
        if not isinstance(value, int) and name.split(".")[1:3] not in _SEARCH_DETAILS
    }


def _reported(kind: str, values: Mapping[str, Any]) -> Mapping[str, Any]:
    """The values, with the mean of an evaluation's returns in their place."""
    returns = values.get("returns")
    if kind != Evaluate.kind or not isinstance(returns, list):
        return values
    numbers = np.asarray(returns)
    if not len(numbers) or numbers.dtype.kind not in "iuf":
        return values
    return {**values, "returns": {f"mean of {len(numbers)}": float(numbers.mean())}}


def _difference(one: Mapping[str, Any], other: Mapping[str, Any]) -> float:
    """The largest difference of two sets of numbers or other values by name."""
    if one.keys() != other.keys():
        return float("inf")
    return max((_gap(one[name], other[name]) for name in one), default=0.0)


def _gap(one: Any, other: Any) -> float:
    if not (_is_number(one) and _is_number(other)):
        return 0.0 if np.array_equal(one, other) else float("inf")
    some, others = np.asarray(one, dtype=np.float64), np.asarray(other, dtype=np.float64)
    if some.shape != others.shape:
        return float("inf")
    size = np.maximum(1.0, np.maximum(np.abs(some), np.abs(others)))
    gaps = np.where(some == others, 0.0, np.abs(some - others) / size)
    return float(np.nan_to_num(gaps, nan=np.inf).max(initial=0.0))


def _is_number(value: Any) -> bool:
    return np.asarray(value).dtype.kind in "iuf"


def _plain(value: Any, name: str = "") -> dict[str, Any]:
    """The leaves of a JSON value by their paths."""
    if isinstance(value, Mapping):
        items = cast(Mapping[str, Any], value).items()
    elif isinstance(value, list):
        items = ((str(i), each) for i, each in enumerate(cast(Sequence[Any], value)))
    else:
        return {name: value}
    return {k: v for key, each in items for k, v in _plain(each, f"{name}.{key}").items()}


def _arrays(content: bytes) -> dict[str, Any]:
    """The arrays of an `.npz` or of safetensors by name; other bytes as they are."""
    if content.startswith(b"PK"):
        return dict(read_arrays(content, names_in(content)))
    try:
        tensors: dict[str, NDArray[Any]] = load(content)
    except SafetensorError:
        return {"": content}
    return dict(tensors)
