"""The target domain: the one door to it, and the meter on the door.

    target = open_target(spec, stages)
    visit = yield from target.rollout(policy, iteration=0)     # counted
    evaluations = yield from target.evaluate([policy])         # counted apart, for no method

No method reads a task's hidden truth: it acts behind this door.
"""

from collections.abc import Generator, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

from adr_service.criticism.recordings import read_recording
from adr_service.errors import BudgetExceeded, InvalidInput
from adr_service.events import RunEvent
from adr_service.specs import ExternalTarget, RecordedTarget, RunSpec
from adr_service.stages.base import Stage, Stages
from adr_service.stages.evaluate import Evaluate, TargetEvaluation
from adr_service.stages.target_episode import RobotEpisode, TargetEpisode
from adr_service.stages.target_return import EpisodeReturn, TargetReturn
from adr_service.stages.target_rollout import Rollout, TargetRollout
from adr_service.tasks.catalogue import get_task, task_inputs
from adr_service.transitions import TransitionDataset, dataset_id

Evaluations = Generator[RunEvent, None, list[TargetEvaluation]]


@dataclass(frozen=True)
class Visit:
    """The metered episodes of one policy, or of random actions, on the target."""

    policy: bytes | None  # None: random actions
    data: TransitionDataset


class Door(Protocol):
    """Stages by which a run visits its target."""

    def rollout(
        self, policy: bytes | None, iteration: int, transitions: int
    ) -> Stage[Rollout] | Stage[RobotEpisode]: ...

    def full_episode(
        self, policy: bytes, iteration: int
    ) -> Stage[EpisodeReturn] | Stage[RobotEpisode]: ...

    def evaluate(self, policies: Sequence[bytes], stages: Stages) -> Evaluations: ...


class Target:
    """The target of one run. Every rollout and every transition is counted.

    The budget is the spec's rollouts, each of at most the spec's transitions, which several
    episodes of random actions may share.
    """

    def __init__(self, spec: RunSpec, stages: Stages, door: Door):
        self._spec, self._stages, self._door = spec, stages, door
        self.rollouts = 0
        self.transitions = 0

    def rollout(self, policy: bytes | None, iteration: int) -> Generator[RunEvent, None, Visit]:
        """One trajectory of `policy`, or of random actions, of at most the spec's transitions."""
        allowed = self._spec.iterations
        if self.rollouts + 1 > allowed:
            raise BudgetExceeded("target rollouts", self.rollouts, 1, allowed)
        data = yield from self._recorded(policy, iteration, self._spec.transitions)
        return Visit(policy, data)

    def random_episodes(self) -> Generator[RunEvent, None, Visit]:
        """Record episodes of random actions until the spec's transitions are recorded."""
        wanted, parts = self._spec.transitions, list[TransitionDataset]()
        allowed = self._spec.iterations * wanted
        if self.transitions + wanted > allowed:
            raise BudgetExceeded("target transitions", self.transitions, wanted, allowed)
        while (missing := wanted - sum(map(len, parts))) > 0:
            parts.append((yield from self._recorded(None, self.rollouts, missing)))
        return Visit(None, TransitionDataset.concatenate(parts))

    def _recorded(
        self, policy: bytes | None, number: int, transitions: int
    ) -> Generator[RunEvent, None, TransitionDataset]:
        """One metered episode."""
        stage: Stage[Any] = self._door.rollout(policy, number, transitions)
        rollout = yield from self._stages.run(stage)
        self.rollouts += 1
        self.transitions += rollout.transitions
        return TransitionDataset.from_npz(rollout.data)

    def returns(
        self, policies: Sequence[bytes], iteration: int
    ) -> Generator[RunEvent, None, list[float]]:
        """The return of one full episode of each policy, which the method may see.

        Metered as rollouts are, beyond the spec's, because UDR's policies come on top.
        """
        stages: list[Stage[Any]] = [self._door.full_episode(p, iteration) for p in policies]
        episodes = yield from self._stages.all(stages)
        self.rollouts += len(episodes)
        self.transitions += sum(episode.transitions for episode in episodes)
        return [episode.earned for episode in episodes]

    def evaluate(self, policies: Sequence[bytes]) -> Evaluations:
        """Final episodes of each policy. No method may see them."""
        return (yield from self._door.evaluate(policies, self._stages))


class SimulatedDoor:
    """Visits to the simulated target, shared by all runs that ask for the same ones."""

    def __init__(self, spec: RunSpec):
        self._spec = spec
        self._where: dict[str, Any] = {
            **task_inputs(spec.task),
            "variant": spec.target_domain,
            "seed": spec.seed,
        }

    def rollout(self, policy: bytes | None, iteration: int, transitions: int) -> Stage[Rollout]:
        return TargetRollout(
            **self._where, transitions=transitions, iteration=iteration, policy=policy
        )

    def full_episode(self, policy: bytes, iteration: int) -> Stage[EpisodeReturn]:
        return TargetReturn(**self._where, iteration=iteration, policy=policy)

    def evaluate(self, policies: Sequence[bytes], stages: Stages) -> Evaluations:
        episodes = self._spec.evaluation_episodes
        asked = [Evaluate(**self._where, episodes=episodes, policy=policy) for policy in policies]
        return (yield from stages.all(asked))


class RobotsDoor:
    """Visits to an external target: each is an episode that a robot's client claims as a task."""

    def __init__(self, spec: RunSpec, run_id: str):
        self._spec, self._horizon = spec, get_task(spec.task).horizon
        self._where: dict[str, Any] = {**task_inputs(spec.task), "run": run_id, "seed": spec.seed}

    def rollout(
        self, policy: bytes | None, iteration: int, transitions: int
    ) -> Stage[RobotEpisode]:
        return TargetEpisode(
            **self._where,
            purpose="rollout",
            number=iteration,
            transitions=transitions,
            policy=policy,
        )

    def full_episode(self, policy: bytes, iteration: int) -> Stage[RobotEpisode]:
        return TargetEpisode(
            **self._where,
            purpose="return",
            number=iteration,
            transitions=self._horizon,
            policy=policy,
        )

    def evaluate(self, policies: Sequence[bytes], stages: Stages) -> Evaluations:
        count = self._spec.evaluation_episodes
        asked = [
            TargetEpisode(
                **self._where,
                purpose="evaluation",
                number=number,
                transitions=self._horizon,
                policy=policy,
            )
            for policy in policies
            for number in range(count)
        ]
        episodes = yield from stages.all(asked)
        earned = [episode.earned for episode in episodes]
        each = [earned[first : first + count] for first in range(0, len(earned), count)]
        return [TargetEvaluation(returns=returns, diverged_episodes=0) for returns in each]


def open_target(spec: RunSpec, stages: Stages) -> Target:
    """The target that a spec names, simulated or external."""
    is_external = isinstance(spec.target, ExternalTarget)
    return Target(
        spec, stages, RobotsDoor(spec, stages.run_id) if is_external else SimulatedDoor(spec)
    )


class Recording:
    """A recorded target: it has shown all that it ever will, and evaluates no policy."""

    def __init__(self, spec: RunSpec, content: bytes | None):
        """`content` are the bytes of the dataset that the spec names."""
        asked = spec.target
        assert isinstance(asked, RecordedTarget)
        if content is None or dataset_id(content) != asked.dataset:
            given = "nothing" if content is None else dataset_id(content)
            raise InvalidInput(f"the run learns from the recording {asked.dataset}; given {given}")
        data = read_recording(get_task(spec.task), content)
        episodes = data.episode_count
        if asked.episodes is not None:
            if asked.episodes > episodes:
                raise InvalidInput(
                    f"{asked.dataset} has {episodes} episodes; asked for the first {asked.episodes}"
                )
            data = data.first_episodes(asked.episodes)
        if spec.method.replay_from == "smoothed":
            data.check_chained("smoothing")
        least = spec.method.least_transitions
        if not len(data.windows(least)):
            raise InvalidInput(
                f"no episode of {asked.dataset} has {least} transitions in a row; "
                f"{spec.method.name} with steps = {least} learns from no fewer"
            )
        self.data = data.to_npz()
        self.rollouts, self.transitions = data.episode_count, len(data)

    def evaluate(self, policies: Sequence[bytes]) -> Evaluations:
        """Nothing: nobody can act on a recording."""
        yield from ()
        return []
