"""PyTorch with a seed from our streams, on one thread: equal numbers on every machine."""

from collections.abc import Generator
from contextlib import contextmanager

import numpy as np
import torch


@contextmanager
def seeded(rng: np.random.Generator) -> Generator[int]:
    """Seed PyTorch's global generator inside the block and restore it afterwards."""
    seed, threads = int(rng.integers(2**31)), torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(seed)
            yield seed
    finally:
        torch.set_num_threads(threads)
