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

from adr_service.errors import InvalidInput
from adr_service.interchange.libraries import library
from adr_service.interchange.onnx_policies import to_onnx
from adr_service.tasks.base import Task
from adr_service.training.policy import Policy

_TEXT = """---
{metadata}
---

# {title}

A policy for `{task}`, trained in simulation on dynamics that {method} inferred from data of the
target (variant `{variant}`, seed {seed}, {iterations} iterations of {transitions} transitions at
most).

{scores}

Return is the undiscounted return on the target, divided by the task's reward threshold,
{threshold:g}. One seed has no interval: its episodes say nothing of other seeds.

- `policy.onnx`: input `observation` (n, {observations}), output `action` (n, {actions}); its
  metadata name the columns.
- `policy.safetensors`: the same network, for `adr_service.training.policy.Policy`.
- `spec.json`: what was submitted, from which the ADR benchmark service computes the same policy.
"""


def write_model_folder(
    folder: Path,
    policy: Policy,
    task: Task,
    spec: Mapping[str, Any],
    rows: Sequence[Mapping[str, Any]],
) -> None:
    """Write the folder of a run's latest policy, new or empty.

    `spec` is the run's, `rows` its results: a row for each iteration. Raises InvalidInput if
    something is in the folder.
    """
    cards = library("huggingface_hub")
    folder.mkdir(parents=True, exist_ok=True)
    if any(folder.iterdir()):
        raise InvalidInput(f"{folder} is not empty; name a new folder")
    about = {"spec": json.dumps(spec)}
    (folder / "policy.safetensors").write_bytes(policy.to_bytes())
    (folder / "policy.onnx").write_bytes(to_onnx(policy, task, about))
    (folder / "spec.json").write_text(json.dumps(spec, indent=1) + "\n")
    method, title = spec["method"]["name"], f"{task.name}, {spec['method']['name']}"
    text = _TEXT.format(
        metadata=_metadata(cards, title, task, spec, rows).to_yaml(),
        title=title,
        task=task.name,
        method=f"`{method}`",
        variant=spec["variant"],
        seed=spec["seed"],
        iterations=spec["iterations"],
        transitions=spec["transitions"],
        scores=_scores(rows),
        threshold=task.reward_threshold,
        observations=policy.layers[0][0].shape[1],
        actions=len(policy.action_low),
    )
    cards.ModelCard(text).save(folder / "README.md")


def _metadata(
    cards: Any,
    title: str,
    task: Task,
    spec: Mapping[str, Any],
    rows: Sequence[Mapping[str, Any]],
) -> Any:
    results = [
        cards.EvalResult(
            task_type="reinforcement-learning",
            dataset_type=task.name,
            dataset_name=f"{task.name}, {spec['variant']}",
            metric_type="mean_reward",
            metric_value=rows[-1]["normalised_return"] * task.reward_threshold,
        )
    ] * bool(rows)
    return cards.ModelCardData(
        library_name="adr-benchmark-service",
        pipeline_tag="reinforcement-learning",
        tags=["reinforcement-learning", "domain-randomization", "sim-to-real", "mujoco", "onnx"],
        model_name=title,
        eval_results=results or None,
    )


def _scores(rows: Sequence[Mapping[str, Any]]) -> str:
    lines = [
        "| iteration | return / threshold | target transitions | episodes |",
        "|---|---|---|---|",
    ]
    lines += [
        f"| {row['iteration']} | {row['normalised_return']:.3f} | {row['target_transitions']:.0f} "
        f"| {row['episodes']} |"
        for row in rows
    ]
    return "\n".join(lines)
