"""The judge of a training: evaluates policies on new draws of the source, and keeps the best."""

import numpy as np

from adr_service.distributions import Distribution
from adr_service.simulation.batch import Simulations
from adr_service.simulation.rollout import run_episodes
from adr_service.tasks.base import Source, Task
from adr_service.training.curve import Evaluation
from adr_service.training.policy import Policy
from adr_service.training.settings import TrainingSettings


class Judge:
    """Keeps the learning curve, and the best policy with the evaluation that it is reported by.

    The best of many noisy evaluations overestimates its policy. So if the settings ask for it, the
    best policy is evaluated again on fresh draws, and that evaluation is reported.
    """

    def __init__(
        self,
        task: Task,
        source: Source,
        distribution: Distribution,
        settings: TrainingSettings,
        rng: np.random.Generator,
    ):
        self.task, self._distribution, self._rng = task, distribution, rng
        self._few = Simulations(task, source, settings.evaluation_episodes)
        count = settings.confirmation
        self._many = None if count is None else Simulations(task, source, count)
        self.curve: list[Evaluation] = []
        self._best: tuple[Policy, Evaluation] | None = None
        self._confirmed = False  # true if the best was evaluated again

    @property
    def policy(self) -> Policy:
        """The best policy so far, of one evaluation at least."""
        assert self._best is not None
        return self._best[0]

    def evaluate(self, policy: Policy, steps: int) -> Evaluation:
        """A new point of the learning curve."""
        point = self._measured(self._few, policy, steps)
        if self._best is None or point.mean_return > self._best[1].mean_return:
            self._best, self._confirmed = (policy, point), False
        self.curve.append(point)
        return point

    def reported(self) -> Evaluation:
        """The evaluation of the best policy, on fresh draws where the settings ask for it."""
        assert self._best is not None
        policy, point = self._best
        if self._many is not None and not self._confirmed:
            self._best = policy, self._measured(self._many, policy, point.steps)
            self._confirmed = True
        return self._best[1]

    def has_reached(self, threshold: float) -> bool:
        """True if the best policy earns the threshold.

        Where it is evaluated again, its mean less one standard error must earn it.
        """
        assert self._best is not None
        if self._best[1].mean_return < threshold:
            return False
        point = self.reported()
        margin = 0.0 if self._many is None else point.standard_error
        return point.mean_return - margin >= threshold

    def _measured(self, simulations: Simulations, policy: Policy, steps: int) -> Evaluation:
        n = simulations.n
        simulations.set_dynamics(self._distribution.sample(n, self._rng).values)
        initial = self.task.initial(n, self._rng)
        episodes = run_episodes(self.task, simulations, policy.act, initial, self.task.horizon)
        error = float(np.std(episodes.returns, ddof=1) / np.sqrt(n))
        mean_return = float(np.mean(episodes.returns))
        return Evaluation(steps=steps, mean_return=mean_return, standard_error=error)
