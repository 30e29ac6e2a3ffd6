"""A policy as a folder for the Hugging Face Hub: its files, and a model card.

    write_model_folder(Path("hopper-dropo"), policy, get_task("hopper"), spec, rows)
    # then: hf upload you/hopper-dropo hopper-dropo

The folder has the policy as safetensors and as ONNX, the run's spec, and `README.md` with the Hub's
metadata: among them the return on the target, as a result of reinforcement learning.
"""

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from adr_service.errors import InvalidInput
from adr_service.interchange.libraries import library
from adr_service.interchange.onnx_policies import to_onnx
from adr_service.json_values import explain
from adr_service.methods.catalogue import methods
from adr_service.specs import RunSpec
from adr_service.tasks.base import Task
from adr_service.training.policy import Policy

_TEXT = """---
{metadata}
---

# {title}

A policy for `{task}`, trained in simulation on {dynamics} ({circumstances}).

{scores}


- `policy.onnx`: input `observation` (n, {observations}), output `action` (n, {actions}); its
  metadata name the columns.
- `policy.safetensors`: the same network, for `adr_service.training.policy.Policy`.
- `spec.json`: the run's spec, with its preset filled in. The ADR benchmark service computes the
  same policy from it on the same type of CPU, if it has the recording that the run learned from.
"""


def write_model_folder(
    folder: Path,
    policy: Policy,
    task: Task,
    spec: Mapping[str, Any],
    rows: Sequence[Mapping[str, Any]],
) -> None:
    """Write the folder of a run's latest policy, new or empty.

    `spec` is the run's, `rows` its results: a row for each iteration, none for a run on a
    recording. Raises InvalidInput if something is in the folder, or if the spec names what this
    installation does not know, as a method of another package.
    """
    try:
        run = RunSpec.model_validate_json(json.dumps(spec))
    except ValidationError as error:
        raise InvalidInput(f"the run's spec cannot be read here: {explain(error, 'it')}") from error
    cards = library("huggingface_hub")
    if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        raise InvalidInput(f"{folder} is there already, and not empty; name a new folder")
    spec_text = json.dumps(spec, indent=1) + "\n"
    text = _TEXT.format(
        metadata=_metadata(cards, task, run, rows).to_yaml(),
        title=_title(run),
        task=task.name,
        dynamics=_dynamics(run.method.name),
        circumstances=_circumstances(run),
        scores=_scores(task, rows),
        observations=policy.layers[0][0].shape[1],
        actions=len(policy.action_low),
    )
    files = {
        "README.md": text.encode(),
        "policy.safetensors": policy.to_bytes(),
        "policy.onnx": to_onnx(policy, task, {"spec": json.dumps(spec)}),
        "spec.json": spec_text.encode(),
    }
    folder.mkdir(parents=True, exist_ok=True)
    for name, content in files.items():
        (folder / name).write_bytes(content)


def _title(run: RunSpec) -> str:
    return f"{run.task}, {run.column}{run.suffix}"


def _dynamics(method: str) -> str:
    """Words for the dynamics that a method's policies are trained on."""
    known = methods()[method]
    if known.needs_truth:
        return "the target's own dynamics"
    if known.learns_from == "nothing":
        return f"dynamics that know nothing of the target (`{method}`)"
    if known.learns_from == "returns":
        return f"dynamics that `{method}` chose by returns on the target"
    return f"dynamics that `{method}` inferred from data of the target"


def _circumstances(run: RunSpec) -> str:
    """Words for a run's seed and data; only methods that see transitions have a budget."""
    known = f"variant `{run.variant}`, seed {run.seed}{run.suffix}"
    learns_from = methods()[run.method.name].learns_from
    if run.target.kind == "recorded" or learns_from == "nothing":
        return known
    if learns_from == "returns":
        return f"{known}, {run.iterations} iterations with full episodes on the target"
    return (
        f"{known}, {run.iterations} iterations of {run.transitions} transitions of the target at "
        "most"
    )


def _metadata(cards: Any, task: Task, run: RunSpec, rows: Sequence[Mapping[str, Any]]) -> Any:
    """The Hub's metadata; the return stands there if it is of this policy alone."""
    results = [
        cards.EvalResult(
            task_type="reinforcement-learning",
            dataset_type=task.name,
            dataset_name=f"{run.task}, {run.variant}{run.suffix}",
            metric_type="mean_reward",
            metric_value=row["normalised_return"] * task.reward_threshold,
        )
        for row in rows[-1:]
        if row["policies"] == 1
    ]
    return cards.ModelCardData(
        library_name="adr-benchmark-service",
        pipeline_tag="reinforcement-learning",
        tags=["reinforcement-learning", "domain-randomization", "sim-to-real", "mujoco", "onnx"],
        model_name=_title(run),
        eval_results=results or None,
    )


def _scores(task: Task, rows: Sequence[Mapping[str, Any]]) -> str:
    if not rows:
        return "It was evaluated on no target: the run learned from a recording."
    headings = "| iteration | return / threshold | policies | target transitions | episodes |"
    lines = [headings, "|---|---|---|---|---|"]
    lines += [
        f"| {row['iteration']} | {row['normalised_return']:.3f} | {row['policies']} "
        f"| {row['target_transitions']:.0f} | {row['episodes']} |"
        for row in rows
    ]
    lines += [
        "",
        "Return is the undiscounted return on the target, divided by the task's reward threshold, "
        f"{task.reward_threshold:g}. One seed has no interval: its episodes say nothing of other "
        "seeds. Where an iteration has several policies, the return is their mean, and this is the "
        "first of them.",
    ]
    return "\n".join(lines)
