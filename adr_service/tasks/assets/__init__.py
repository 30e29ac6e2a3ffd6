"""The MJCF files of the tasks."""

from functools import cache
from importlib import resources


@cache
def read(name: str) -> str:
    """The text of one MJCF file."""
    return resources.files("adr_service.tasks.assets").joinpath(name).read_text(encoding="utf-8")
