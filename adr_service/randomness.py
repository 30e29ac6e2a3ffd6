"""Named random streams: the same names give the same numbers, in any order and on any machine.

    rng = stream("stage", stage.digest)

Nobody seeds a global generator; a stream is an argument.
"""

import hashlib

import numpy as np


def stream(*names: str | int) -> np.random.Generator:
    """The generator of a path of names, independent of all other paths' generators."""
    path = "\x1f".join(str(name) for name in names)
    words = np.frombuffer(hashlib.sha256(path.encode()).digest(), dtype=np.uint32)
    return np.random.default_rng(np.random.SeedSequence(words.tolist()))


def integer_seed(rng: np.random.Generator) -> int:
    """A seed below 2**31 for libraries that take only an integer (SB3)."""
    return int(rng.integers(1, 2**31 - 1))
