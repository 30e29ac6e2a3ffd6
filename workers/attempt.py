"""One try at a stage."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Attempt:
    """Times in seconds since the epoch."""

    number: int
    started_by: str  # run id
    asked: float  # when the stage was, for the first time
    placed: float  # when it was given a core
    cores: int  # of the cluster
    lease: str | None  # of the visit to the simulated target
