"""Learning curves as TensorBoard's event files.

    write_events(Path("logs/run_0123456789abcdef"), client.curves("run_0123456789abcdef"))

Each training is a run of TensorBoard, `training_0` and so on, with the scalars
`eval/mean_reward`, Stable-Baselines3's name, and `eval/standard_error` over the steps of its
environments. Events are on the wall clock where points have a `time` (ISO 8601).
"""

from collections.abc import Mapping, Sequence
from datetime import datetime
from pathlib import Path
from typing import Any

from adr_service.errors import InvalidInput
from adr_service.interchange.libraries import library

_SCALARS = {"eval/mean_reward": "mean_return", "eval/standard_error": "standard_error"}


def write_events(folder: Path, curves: Sequence[Mapping[str, Any]]) -> None:
    """Write points (`training`, `steps`, `mean_return`, `standard_error`) into a new folder.

    Returns are undiscounted, steps of the environments. Raises InvalidInput if the folder exists:
    a second file beside the first would show every point twice.
    """
    writers = library("tensorboardX")
    if folder.exists():
        raise InvalidInput(f"{folder} is there already; name another folder")
    for training in sorted({point["training"] for point in curves}):
        with writers.SummaryWriter(str(folder / f"training_{training}")) as writer:
            for point in curves:
                if point["training"] != training:
                    continue
                time = (
                    datetime.fromisoformat(point["time"]).timestamp() if "time" in point else None
                )
                for tag, name in _SCALARS.items():
                    writer.add_scalar(tag, point[name], point["steps"], time)
