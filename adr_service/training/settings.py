"""Algorithms of policy training with their hyperparameters; imports no library that trains."""

from abc import abstractmethod
from collections.abc import Mapping
from importlib.util import find_spec
from itertools import pairwise
from typing import Annotated, Any, ClassVar, Literal, Self, TypeAlias, cast

from pydantic import Discriminator, Field, Tag, model_validator

from adr_service.citations import Paper
from adr_service.errors import InvalidInput
from adr_service.json_values import Wire

Widths = Annotated[
    list[Annotated[int, Field(ge=1, le=4096)]], Field(min_length=1, max_length=8)
]  # units per hidden layer

DEFAULT_ALGORITHM: Literal["sac"] = "sac"
_WORK = 256 * 128**2  # batch size x weights, for which the seconds of an update are given
# settings that were no choice at first, with what they were
_AT_FIRST = (
    ("algorithm", "sac"),
    ("start", "scratch"),
    ("averaged_steps", 0),
    ("action_bins", None),
    ("learning_rate_schedule", "constant"),
)
_STEP_S = 0.0007  # acting and storing, per step of all environments
_LEARNING_STARTS = (
    "steps of uniformly random actions, fewer than max_steps; where the default is not, half of "
    "max_steps"
)
_LARGEST_RATE = 1000  # far above any that learns, and a number in float32


def check_backend(name: str | None) -> None:
    """Raise InvalidInput for SBX where it is not installed."""
    if name == "sbx" and find_spec("sbx") is None:
        raise InvalidInput(
            "backend 'sbx' needs sbx-rl: pip install 'adr-service[fast]', or use 'sb3'"
        )


class _Settings(Wire):
    """Settings that all algorithms have."""

    paper: ClassVar[Paper]  # to cite for the algorithm

    backend: Literal["sbx", "sb3"] | None = Field(
        None, description="null: sbx where it is installed, else sb3"
    )
    max_steps: int = Field(
        5_000_000, ge=100, le=10**10, description="environment steps, of all environments"
    )
    environments: int = Field(
        12, ge=1, le=1024, description="number of environments stepped together"
    )
    hidden: Widths = Field([128, 128], description="units per hidden layer of the actor")
    activation: Literal["relu", "tanh"] = Field(
        "tanh", description="activation function between hidden layers"
    )
    batch_size: int = Field(256, ge=1, le=65_536, description="transitions per update")
    gamma: float = Field(0.99, gt=0, lt=1, description="discount factor per step")
    evaluate_every: int = Field(40_000, ge=100, le=10**9, description="environment steps")
    evaluation_episodes: int = Field(
        50,
        ge=2,
        le=10_000,
        description="episodes of each evaluation, which chooses the best policy",
    )
    averaged_steps: int = Field(
        0,
        ge=0,
        le=10**9,
        description="environment steps after which a policy counts 1/e in the mean of weights "
        "that is kept; 0: the last weights are kept",
    )
    stop_at_threshold: bool = Field(
        True, description="end as soon as an evaluation earns the task's reward threshold"
    )
    start: Literal["scratch", "previous"] = Field(
        "scratch",
        description="previous: where policies of a run follow one another, each starts from the "
        "networks of the one before",
    )

    @property
    @abstractmethod
    def steps(self) -> int:
        """Environment steps of a policy whose training nothing stops early."""
        ...

    @property
    @abstractmethod
    def confirmation(self) -> int | None:
        """Fresh episodes that confirm the best evaluation; None: it stands as it is."""
        ...

    @abstractmethod
    def learning_seconds(self, inputs: int) -> float:
        """Expected seconds of acting and updating on one core, without simulations.

        `inputs` are those of a critic: observations and actions.
        """
        ...

    def policy_bytes(self, observations: int, actions: int) -> int:
        """The size of an actor's weights, in float32."""
        widths = [observations, *self.hidden, actions]
        return 4 * sum((a + 1) * b for a, b in pairwise(widths))

    def to_json(self) -> dict[str, Any]:
        """The settings in a stage's digest.

        Settings that are newer than stored results are left out where they change nothing.
        """
        return {
            name: value
            for name, value in self.model_dump().items()
            if (name, value) not in _AT_FIRST
        }

    @model_validator(mode="after")
    def _choose_backend(self) -> Self:
        if self.backend is None:
            object.__setattr__(self, "backend", "sb3" if find_spec("sbx") is None else "sbx")
        return self


class _Confirmed(_Settings):
    """Settings of algorithms that report a policy by fresh episodes, not by its best evaluation."""

    evaluation_episodes: int = Field(10, ge=2, le=10_000, description="of a learning curve's point")
    confirmation_episodes: int = Field(
        50, ge=2, le=10_000, description="fresh ones, by which the best policy is reported"
    )

    @property
    def confirmation(self) -> int | None:
        return self.confirmation_episodes


class _OffPolicy(_Settings):
    """Settings of algorithms that update at every step, on transitions from a replay buffer."""

    # Seconds of an update on one server core, by backend, measured in trainings (docs/training.md):
    # a part that does not shrink with the networks, and one in proportion to them, for `_WORK`
    update_seconds: ClassVar[Mapping[str, tuple[float, float]]]

    gradient_steps: int = Field(
        1, ge=1, le=10_000, description="updates per step of all environments"
    )
    buffer_size: int = Field(
        1_000_000, ge=1000, le=10**8, description="transitions that the replay buffer holds"
    )
    learning_starts: int = Field(100, ge=0, le=10**9, description=_LEARNING_STARTS)

    @property
    def steps(self) -> int:
        return self.max_steps

    @model_validator(mode="after")
    def _leave_steps_to_learn_from(self) -> Self:
        """Refuse random steps until the end; a default that would be so many is made shorter."""
        if self.max_steps < self.environments:
            raise ValueError(
                f"max_steps: {self.max_steps} given, fewer than the {self.environments} "
                "environments, which are stepped together"
            )
        if self.learning_starts >= self.max_steps:
            if "learning_starts" in self.model_fields_set:
                raise ValueError(
                    f"learning_starts: {self.learning_starts} given, not fewer than the "
                    f"{self.max_steps} of max_steps: no step would be left to learn from"
                )
            object.__setattr__(self, "learning_starts", self.max_steps // 2)
        return self

    @property
    def capacity(self) -> int:
        """The size of the replay buffer: no larger than a training can fill, to save time."""
        return min(self.buffer_size, self.max_steps + self.environments)

    @abstractmethod
    def critic_weights(self, inputs: int) -> int:
        """The number of a critic's weights."""
        ...

    def learning_seconds(self, inputs: int) -> float:
        assert self.backend is not None, "validation has chosen one"
        fixed, proportional = self.update_seconds[self.backend]
        update = fixed + proportional * self.batch_size * self.critic_weights(inputs) / _WORK
        rounds = self.max_steps / self.environments
        return rounds * (self.gradient_steps * update + _STEP_S)


class SacSettings(_OffPolicy):
    """Soft Actor-Critic (Haarnoja et al., arXiv 1812.05905).

    Defaults are those of the benchmark's paper (Tiboni et al., Sec. 3.4), of its authors' code
    (tanh between layers, which the paper does not mention), else SB3's.
    """

    hidden: Widths = Field(
        [128, 128], description="units per hidden layer of the actor and of each critic"
    )

    paper: ClassVar = Paper(
        "haarnoja2018sac",
        "Soft Actor-Critic Algorithms and Applications",
        "Haarnoja, Tuomas and Zhou, Aurick and Hartikainen, Kristian and Tucker, George and "
        "Ha, Sehoon and Tan, Jie and Kumar, Vikash and Zhu, Henry and Gupta, Abhishek and "
        "Abbeel, Pieter and Levine, Sergey",
        2018,
        arxiv="1812.05905",
    )
    update_seconds: ClassVar = {"sbx": (0.00005, 0.0027), "sb3": (0.0025, 0.0112)}

    algorithm: Literal["sac"] = DEFAULT_ALGORITHM
    learning_rate: float | None = Field(
        None, gt=0, le=_LARGEST_RATE, description="null: the task's own"
    )
    tau: float = Field(
        0.005, gt=0, le=1, description="share of the target networks that an update replaces"
    )

    @property
    def confirmation(self) -> int | None:
        return None

    def critic_weights(self, inputs: int) -> int:
        return _weights(inputs, self.hidden)


class CrossQSettings(_Confirmed, _OffPolicy):
    """CrossQ (Bhatt et al., arXiv 1902.05605): SAC with batch renormalisation in the place of
    target networks."""

    paper: ClassVar = Paper(
        "bhatt2024crossq",
        "CrossQ: Batch Normalization in Deep Reinforcement Learning for Greater Sample Efficiency "
        "and Simplicity",
        "Bhatt, Aditya and Palenicek, Daniel and Belousov, Boris and Argus, Max and "
        "Amiranashvili, Artemij and Brox, Thomas and Peters, Jan",
        2024,
        conference="International Conference on Learning Representations",
        arxiv="1902.05605",
    )
    update_seconds: ClassVar = {"sbx": (0.0012, 0.0015), "sb3": (0.0110, 0.0008)}

    algorithm: Literal["crossq"]
    learning_rate: float = Field(0.001, gt=0, le=_LARGEST_RATE, description="learning rate of Adam")
    # one transition has no variance to normalise by
    batch_size: int = Field(256, ge=2, le=65_536, description="transitions per update")
    learning_starts: int = Field(1000, ge=0, le=10**9, description=_LEARNING_STARTS)
    critic_hidden: Widths = Field([128, 128], description="units per hidden layer of the critics")
    policy_delay: int = Field(3, ge=1, le=100, description="critic updates per actor update")
    activation: Literal["relu", "tanh"] = Field(
        "relu", description="activation function between hidden layers"
    )

    def critic_weights(self, inputs: int) -> int:
        return _weights(inputs, self.critic_hidden)


class PpoSettings(_Confirmed):
    """Proximal Policy Optimisation (Schulman et al., arXiv 1707.06347) on normalised observations
    and rewards."""

    paper: ClassVar = Paper(
        "schulman2017ppo",
        "Proximal Policy Optimization Algorithms",
        "Schulman, John and Wolski, Filip and Dhariwal, Prafulla and Radford, Alec and "
        "Klimov, Oleg",
        2017,
        arxiv="1707.06347",
    )
    # of an update on one server core, per transition and epoch, for 64**2 weights
    sample_seconds: ClassVar[Mapping[str, float]] = {"sbx": 0.00000045, "sb3": 0.00000225}

    algorithm: Literal["ppo"]
    environments: int = Field(
        32, ge=1, le=1024, description="number of environments stepped together"
    )
    hidden: Widths = Field([128, 128], description="units per hidden layer of the actor and critic")
    batch_size: int = Field(512, ge=2, le=65_536, description="transitions per update")
    learning_rate: float = Field(
        0.0005, gt=0, le=_LARGEST_RATE, description="learning rate of Adam"
    )
    learning_rate_schedule: Literal["constant", "linear"] = Field(
        "constant", description="linear: the rate falls to 0, which it reaches at the last rollout"
    )
    rollout_steps: int = Field(128, ge=1, le=65_536, description="of each environment")
    epochs: int = Field(10, ge=1, le=1000, description="over the transitions of each rollout")
    gae_lambda: float = Field(
        0.95, ge=0, le=1, description="lambda of generalised advantage estimation"
    )
    clip_range: float = Field(
        0.2, gt=0, description="range to which the ratio of probabilities is clipped"
    )
    entropy_coefficient: float = Field(0.0, ge=0, description="weight of the entropy bonus")
    log_deviation: float = Field(
        0.0, ge=-10, le=2, description="initial log standard deviation of actions in [-1, 1]"
    )
    ortho_init: bool = Field(
        True,
        description="the actor's last layer begins orthogonal and small, so that the first mean "
        "actions are near zero (Andrychowicz et al., arXiv 2006.05990); with sb3 all other layers "
        "begin orthogonal, too",
    )
    action_bins: int | None = Field(
        None,
        ge=2,
        le=101,
        description="values that each action may take, evenly spaced over its bounds (Tang and "
        "Agrawal, arXiv 1901.10500); null: actions are drawn from a Gaussian",
    )

    @property
    def transitions(self) -> int:
        """The number of transitions in a rollout, of all environments."""
        return self.rollout_steps * self.environments

    @property
    def steps(self) -> int:
        """Environment steps of all rollouts that `max_steps` allows."""
        return self.max_steps - self.max_steps % self.transitions

    @model_validator(mode="after")
    def _fits(self) -> Self:
        if self.transitions % self.batch_size:
            raise ValueError(
                f"batch_size: {self.batch_size} given, which does not divide the "
                f"{self.transitions} transitions of a rollout (rollout_steps x environments)"
            )
        if self.max_steps < 2 * self.transitions:
            raise ValueError(
                f"max_steps: {self.max_steps} given, fewer than the {2 * self.transitions} "
                "transitions of two rollouts (rollout_steps x environments each); a policy is "
                "evaluated before the update that its rollout leads to"
            )
        if self.action_bins is not None and self.log_deviation != 0:
            raise ValueError(
                f"log_deviation: {self.log_deviation} and action_bins: {self.action_bins} given, "
                "one of them perhaps by the preset, but bins have no Gaussian; give log_deviation "
                "0 or action_bins null"
            )
        return self

    def policy_bytes(self, observations: int, actions: int) -> int:
        return super().policy_bytes(observations, actions * (self.action_bins or 1))

    def learning_seconds(self, inputs: int) -> float:
        assert self.backend is not None, "validation has chosen one"
        sample = self.sample_seconds[self.backend] * _weights(inputs, self.hidden) / 64**2
        return self.steps * (_STEP_S / self.environments + self.epochs * sample)


def _weights(inputs: int, hidden: list[int]) -> int:
    """The number of weights of a critic with these hidden layers."""
    return sum(a * b for a, b in pairwise([inputs, *hidden, 1]))


def _algorithm(given: Any) -> Any:
    if isinstance(given, dict):
        return cast(dict[str, Any], given).get("algorithm", DEFAULT_ALGORITHM)
    return getattr(given, "algorithm", None)


TrainingSettings: TypeAlias = Annotated[
    Annotated[SacSettings, Tag("sac")]
    | Annotated[CrossQSettings, Tag("crossq")]
    | Annotated[PpoSettings, Tag("ppo")],
    Discriminator(
        _algorithm,
        custom_error_type="unknown_algorithm",
        custom_error_message="give training settings whose algorithm is 'sac' (the default), "
        "'crossq' or 'ppo'",
    ),
]
