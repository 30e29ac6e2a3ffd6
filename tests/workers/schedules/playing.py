"""Many schedules, some of them on the database.

figures = play_all(range(10_000))       # Violation, with the seed of the schedule
"""

import logging
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from db.session import open_database
from tests.workers.schedules.ledgers import DatabaseLedger, MemoryLedger
from tests.workers.schedules.world import Figures, World

_ON_DATABASE = 50  # one schedule of so many, since each takes twenty times as long there
_MEMORY = Path("/dev/shm")  # noqa: S108 - a file system that never waits for a disk


def play_all(seeds: Iterable[int]) -> Figures:
    """The figures of these schedules together. Raises Violation, with the seed."""
    figures = Figures()
    folder = _MEMORY if _MEMORY.is_dir() else None
    with TemporaryDirectory(dir=folder) as name:
        database = open_database(f"sqlite:///{name}/adr.sqlite")
        try:
            for seed in seeds:
                is_stored = seed % _ON_DATABASE == 0
                ledger = DatabaseLedger(database) if is_stored else MemoryLedger()
                with _noting(seed):
                    figures += World(np.random.default_rng(seed), ledger).play()
                figures.on_database += is_stored
        finally:
            database.close()
    return figures


@contextmanager
def silent() -> Iterator[None]:
    """Let the service log nothing of its troubles meanwhile."""
    logging.disable(logging.CRITICAL)
    try:
        yield
    finally:
        logging.disable(logging.NOTSET)


@contextmanager
def _noting(seed: int) -> Iterator[None]:
    try:
        yield
    except BaseException as error:
        error.add_note(f"schedule {seed}; again: python -m tests.workers.schedules {seed}")
        raise
