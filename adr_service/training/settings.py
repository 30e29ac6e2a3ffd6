"""Hyperparameters of policy training, importable without the libraries that train."""

import importlib.util
from itertools import pairwise
from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from adr_service.json_values import Wire


class TrainingSettings(Wire):
    """Hyperparameters of one policy training; defaults are the paper's, else SB3's."""

    backend: Literal["sbx", "sb3"] | None = Field(
        None, description="null: sbx where it is installed, else sb3"
    )
    max_steps: int = Field(
        5_000_000, ge=100, le=10**10, description="environment steps, all environments"
    )
    environments: int = Field(12, ge=1, le=1024)
    gradient_steps: int = Field(
        1, ge=1, le=10_000, description="updates per step of all environments"
    )
    hidden: list[Annotated[int, Field(ge=1, le=4096)]] = Field(
        [128, 128], min_length=1, max_length=8, description="units per hidden layer"
    )
    activation: Literal["relu", "tanh"] = "tanh"
    learning_rate: float | None = Field(None, gt=0, description="null: the task's own")
    batch_size: int = Field(256, ge=1, le=65_536)
    buffer_size: int = Field(1_000_000, ge=1000, le=10**8)
    learning_starts: int = Field(
        100, ge=0, le=10**9, description="steps of uniformly random actions"
    )
    gamma: float = Field(0.99, gt=0, lt=1)
    tau: float = Field(0.005, gt=0, le=1)
    evaluate_every: int = Field(40_000, ge=100, le=10**9, description="environment steps")
    evaluation_episodes: int = Field(50, ge=1, le=10_000)
    stop_at_threshold: bool = True

    def policy_bytes(self, observations: int, actions: int) -> int:
        """The size of an actor's weights, in float32."""
        widths = [observations, *self.hidden, actions]
        return 4 * sum((a + 1) * b for a, b in pairwise(widths))

    @model_validator(mode="after")
    def _choose_backend(self) -> Self:
        if self.backend is None:
            installed = importlib.util.find_spec("sbx") is not None
            object.__setattr__(self, "backend", "sbx" if installed else "sb3")
        return self
