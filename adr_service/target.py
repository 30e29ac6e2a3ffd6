"""The target domain: the one door to it, and the meter on the door.

    target = open_target(spec, stages)
    visit = yield from target.rollout(policy, iteration=0)     # counted
    found = yield from target.evaluate([policy])               # counted apart, for no method

No method reads a task's hidden truth: it acts behind this door. Simulated targets live here
too: `simulate_rollout` and `simulate_evaluation` are what the target stages compute. What a robot
did arrives as an `.npz` and is checked by `episode_result`.
"""

from collections.abc import Callable, Generator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from adr_service.arrays import Matrix, Vector
from adr_service.distributions import Uniform
from adr_service.errors import BudgetExceeded, InvalidInput
from adr_service.events import RunEvent
from adr_service.npz import read_arrays
from adr_service.simulation.batch import Simulations, control_period
from adr_service.simulation.replay import check_recorded
from adr_service.simulation.rollout import Act, Episodes, run_episodes
from adr_service.specs import ExternalTarget, RecordedTarget, RunSpec
from adr_service.stages import Stage, StageResult, Stages
from adr_service.tasks.base import Task
from adr_service.tasks.catalogue import get_task, hidden_of, identity_of, variant_of
from adr_service.training.policy import Policy
from adr_service.transitions import TransitionDataset, dataset_id


@dataclass(frozen=True)
class Visit:
    """One metered rollout: what the target showed of one policy."""

    policy: bytes | None  # None: random actions
    data: bytes  # a TransitionDataset as .npz
    transitions: int


class Target:
    """The target of one run. Every rollout and every transition is counted.

    The budget is the spec's rollouts, each of at most the spec's transitions.
    """

    def __init__(self, spec: RunSpec, stages: Stages):
        self._spec, self._stages = spec, stages
        self.rollouts = 0
        self.transitions = 0

    def rollout(self, policy: bytes | None, iteration: int) -> Generator[RunEvent, None, Visit]:
        """One trajectory of `policy`, or of random actions, of at most the spec's transitions."""
        spec = self._spec
        if self.rollouts + 1 > spec.iterations:
            raise BudgetExceeded("target rollouts", self.rollouts, 1, spec.iterations)
        result = yield from self._stages.run(self._rollout(policy, iteration))
        taken = int(result.values["transitions"])
        self.rollouts += 1
        self.transitions += taken
        return Visit(policy, result.blobs["data"], taken)

    def returns(
        self, policies: Sequence[bytes], iteration: int
    ) -> Generator[RunEvent, None, list[float]]:
        """The return of one full episode of each policy, which the method may see.

        Metered as rollouts are, beyond the spec's, because UDR's policies come on top.
        """
        results = yield from self._stages.all([self._return(p, iteration) for p in policies])
        self.rollouts += len(results)
        self.transitions += sum(int(result.values["transitions"]) for result in results)
        return [float(result.values["return"]) for result in results]

    def evaluate(
        self, policies: Sequence[bytes]
    ) -> Generator[RunEvent, None, list[dict[str, Any]]]:
        """What the evaluation stage found of each policy. No method may see it."""
        spec = self._spec
        results = yield from self._stages.all(
            [
                Stage(
                    "evaluate",
                    {
                        **identity_of(spec.task),
                        "variant": spec.target_domain,
                        "episodes": spec.evaluation_episodes,
                        "seed": spec.seed,
                    },
                    {"policy": policy},
                )
                for policy in policies
            ]
        )
        return [result.values for result in results]

    def _rollout(self, policy: bytes | None, iteration: int) -> Stage:
        inputs = {
            **identity_of(self._spec.task),
            "variant": self._spec.target_domain,
            "transitions": self._spec.transitions,
            "iteration": iteration,
            "seed": self._spec.seed,
        }
        return Stage("target_rollout", inputs, {} if policy is None else {"policy": policy})

    def _return(self, policy: bytes, iteration: int) -> Stage:
        inputs = {
            **identity_of(self._spec.task),
            "variant": self._spec.target_domain,
            "iteration": iteration,
            "seed": self._spec.seed,
        }
        return Stage("target_return", inputs, {"policy": policy})


class RobotTarget(Target):
    """A target outside: each visit is an episode that a robot's client takes as a task.

    Episodes are of one run: robots do not repeat themselves.
    """

    def evaluate(
        self, policies: Sequence[bytes]
    ) -> Generator[RunEvent, None, list[dict[str, Any]]]:
        count = self._spec.evaluation_episodes
        asked = [self._full("evaluation", i, policy) for policy in policies for i in range(count)]
        results = yield from self._stages.all(asked)
        returns = [result.values["return"] for result in results]
        each = [returns[first : first + count] for first in range(0, len(returns), count)]
        return [{"returns": episodes, "diverged_episodes": 0} for episodes in each]

    def _rollout(self, policy: bytes | None, iteration: int) -> Stage:
        return self._episode("rollout", iteration, policy, self._spec.transitions)

    def _return(self, policy: bytes, iteration: int) -> Stage:
        return self._full("return", iteration, policy)

    def _full(self, purpose: str, number: int, policy: bytes) -> Stage:
        return self._episode(purpose, number, policy, get_task(self._spec.task).horizon)

    def _episode(self, purpose: str, number: int, policy: bytes | None, transitions: int) -> Stage:
        inputs = {
            **identity_of(self._spec.task),
            "run": self._stages.run_id,
            "purpose": purpose,  # "rollout", of which fewer transitions are as good; else a return
            "number": number,
            "transitions": transitions,
            "seed": self._spec.seed,
        }
        return Stage("target_episode", inputs, {} if policy is None else {"policy": policy})


_MOST_COLUMNS = 1_000  # of observations


def open_target(spec: RunSpec, stages: Stages) -> Target:
    """The target that a spec names, simulated or outside."""
    return (RobotTarget if isinstance(spec.target, ExternalTarget) else Target)(spec, stages)


def episode_result(inputs: Mapping[str, Any], content: bytes) -> StageResult:
    """What a robot's episode is worth as the result of a `target_episode`.

    `content` is the `.npz` of a TransitionDataset with `rewards` (N,). Raises InvalidInput where
    it is not of the task, is not one episode, or is longer than was asked for.
    """
    # a name for each column takes rows too
    longest = max(inputs["transitions"], _MOST_COLUMNS)
    fields = read_arrays(content, (*TransitionDataset.ARRAYS, "rewards"), longest)
    rewards = fields.pop("rewards", None)
    data = TransitionDataset.from_arrays(fields)
    check_recorded(get_task(inputs["task"]), data)
    if data.episode_count != 1:
        raise InvalidInput(f"a task is one episode; the data have {data.episode_count}")
    if len(data) > inputs["transitions"]:
        raise InvalidInput(
            f"the task asks for {inputs['transitions']} transitions at most; given {len(data)}"
        )
    if rewards is None or rewards.dtype.kind not in "iuf" or rewards.shape != (len(data),):
        given = "nothing" if rewards is None else f"{rewards.dtype} {rewards.shape}"
        raise InvalidInput(f"rewards must be ({len(data)},) numbers; given {given}")
    earned = float(np.sum(rewards, dtype=np.float64))
    if not np.isfinite(earned):
        raise InvalidInput("rewards must be finite, and their sum")
    return StageResult({"transitions": len(data), "return": earned}, {"data": data.to_npz()})


class Recording:
    """A recorded target: it has shown all that it ever will, and evaluates no policy."""

    def __init__(self, spec: RunSpec, content: bytes | None):
        """`content` are the bytes of the dataset that the spec names."""
        asked = spec.target
        assert isinstance(asked, RecordedTarget)
        if content is None or dataset_id(content) != asked.dataset:
            given = "nothing" if content is None else dataset_id(content)
            raise InvalidInput(f"the run learns from the recording {asked.dataset}; given {given}")
        data = TransitionDataset.from_npz(content)
        check_recorded(get_task(spec.task), data)
        episodes = data.episode_count
        if asked.episodes is not None:
            if asked.episodes > episodes:
                raise InvalidInput(
                    f"{asked.dataset} has {episodes} episodes; asked for the first {asked.episodes}"
                )
            data = data.first_episodes(asked.episodes)
        self.data = data.to_npz()
        self.rollouts, self.transitions = data.episode_count, len(data)

    def evaluate(
        self, policies: Sequence[bytes]
    ) -> Generator[RunEvent, None, list[dict[str, Any]]]:
        yield from ()
        return []


def truth_as_distribution(task_name: str, variant: str) -> Uniform:
    """Certainty about the truth, in the target's own space: what the oracle is trained on."""
    hidden = hidden_of(task_name, variant)
    return Uniform.point(hidden.source.space, hidden.values)


def estimation_error(task_name: str, variant: str, mean: Vector) -> float:
    """Root-mean-square distance of an estimate's mean from the truth, in [0, 4] coordinates.

    For reports alone. Over the parameters of the variant's source space.
    """
    pair = variant_of(task_name, variant)
    space, truth = pair.source.space, pair.truth
    return float(np.sqrt(np.mean((space.normalise(mean) - space.normalise(truth)) ** 2)))


def true_values(task_name: str, variant: str) -> dict[str, float]:
    """The hidden truth by parameter name. For reports alone."""
    hidden = hidden_of(task_name, variant)
    return dict(zip(hidden.source.space.names, hidden.values.tolist(), strict=True))


def simulate_rollout(
    task: Task, variant: str, act: Act, transitions: int, rng: np.random.Generator
) -> TransitionDataset:
    """One episode of `act` on the simulated target, clipped to `transitions`.

    Where the simulation diverges, the recording ends before that step.
    """
    episode = _episodes(task, variant, act, 1, transitions, rng)
    length = int(episode.lengths[0]) - int(episode.diverged[0])
    if length == 0:
        raise InvalidInput(f"the simulated target {task.name} diverged at its first step")
    observations = episode.observations[0, : length + 1]
    return TransitionDataset(
        observations=observations[:-1],
        actions=episode.actions[0, :length],
        next_observations=observations[1:],
        episodes=np.zeros(length, dtype=np.int64),
        dt=control_period(task),
        columns=task.columns[: task.measured],
        origin=f"simulated target {task.name} {variant}",
    )


def simulate_evaluation(
    task: Task, variant: str, policy: Policy, episodes: int, rng: np.random.Generator
) -> Episodes:
    """Full episodes of the policy on the simulated target."""
    return _episodes(task, variant, policy.act, episodes, task.horizon, rng)


def _episodes(
    task: Task, variant: str, act: Act, n: int, steps: int, rng: np.random.Generator
) -> Episodes:
    hidden = hidden_of(task.name, variant)
    simulations = Simulations(task, hidden.source, n)
    simulations.set_dynamics(np.tile(hidden.values, (n, 1)))
    deviation, width = np.sqrt(hidden.noise_variance), task.measured
    noise: Callable[[], Matrix] | None = None
    if deviation > 0:
        noise = lambda: deviation * rng.standard_normal((n, width))  # noqa: E731
    return run_episodes(task, simulations, act, task.initial(n, rng), steps, noise)
