"""Seconds this process has spent on getting ready to compute: imports and compilations.

    with preparing():
        import torch

They are paid once per process, so reports of what stages cost name them apart.
"""

import time
from collections.abc import Generator
from contextlib import contextmanager

_seconds = 0.0


@contextmanager
def preparing() -> Generator[None]:
    started = time.perf_counter()
    try:
        yield
    finally:
        add_preparation(time.perf_counter() - started)


def add_preparation(seconds: float) -> None:
    global _seconds  # noqa: PLW0603 - of the process, as what it counts is
    _seconds += seconds


def preparation_seconds() -> float:
    """All of it since the process began."""
    return _seconds
