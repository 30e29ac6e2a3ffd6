"""Seconds this process has spent on getting ready to compute: imports and compilations.

    with preparing():
        import torch

Imports are paid once per process, compilations once per training: reports of what stages cost
name them apart. JAX's tracing, which is nested, is not counted.
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
