"""PyTorch with a seed from our streams, on one thread: equal numbers on every machine."""

from collections.abc import Generator
from contextlib import contextmanager

import numpy as np
import torch


@contextmanager
def seeded(rng: np.random.Generator) -> Generator[int]:
    """Seed PyTorch's global generator inside the block and restore it afterwards."""
    seed = int(rng.integers(2**31))
    with on_one_thread(), torch.random.fork_rng(devices=[]):
        torch.manual_seed(seed)
        yield seed


@contextmanager
def on_one_thread() -> Generator[None]:
    """Let PyTorch have one thread inside the block, because last bits depend on how many."""
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(threads)
