"""CPU seconds that this process has spent on imports and compilations before it could compute.

    with preparing():
        import torch

Imports happen once per process and compilations once per training, so cost reports list them
apart from computing. JAX's tracing, which is nested, is not counted; its compilations are, by the
time that JAX tells, which includes waiting for a core.
"""

import time
from collections.abc import Generator
from contextlib import contextmanager

_seconds = 0.0


@contextmanager
def preparing() -> Generator[None]:
    """Count the time of the block as preparation."""
    started = time.process_time()
    try:
        yield
    finally:
        add_preparation(time.process_time() - started)


def add_preparation(seconds: float) -> None:
    global _seconds  # noqa: PLW0603 - the count belongs to the process
    _seconds += seconds


def preparation_seconds() -> float:
    """Seconds of preparation since the process began."""
    return _seconds
