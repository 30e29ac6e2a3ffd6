"""PyTorch's global generator, seeded from our streams."""

from collections.abc import Generator
from contextlib import contextmanager

import numpy as np
import torch


@contextmanager
def seeded(rng: np.random.Generator) -> Generator[int]:
    """Seed PyTorch's global generator inside the block and restore it afterwards."""
    seed = int(rng.integers(2**31))
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(seed)
        yield seed
