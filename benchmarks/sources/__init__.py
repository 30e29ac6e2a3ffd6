"""Published recordings, as robots' measurements with the models that their authors give."""

import os
from pathlib import Path

from adr_service.errors import InvalidInput


def folder() -> Path:
    """The folder with the recordings; InvalidInput without one."""
    if "ADR_DATASETS" not in os.environ:
        raise InvalidInput("ADR_DATASETS names no folder with the recordings (docs/datasets.md)")
    return Path(os.environ["ADR_DATASETS"])
