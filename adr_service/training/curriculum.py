"""Curricula: distributions that move while a policy is trained on them.

    course = Course(curriculum, source.space, environments=64)
    env = RandomizedVecEnv(task, source, course, 64, rng, ended=course.ended)
    ...                                     # train
    course.phases[-1].distribution          # the last one, JSON

A curriculum is moved after a number of episodes, by their returns. Plain domain randomisation is
the curriculum that never moves.
"""

from typing import Any, Protocol

import numpy as np

from adr_service.arrays import Indices, Matrix, Vector
from adr_service.distributions import Distribution, Draws, check_space
from adr_service.errors import InvalidInput
from adr_service.json_values import Wire
from adr_service.parameters import ParameterSpace


class Curriculum(Protocol):
    """A distribution that moves by what a policy earns on it."""

    episodes: int  # that it learns from before each move, at least

    @property
    def distribution(self) -> Distribution:
        """The present distribution."""
        ...

    def sample(self, n: int, rng: np.random.Generator) -> Draws:
        """The dynamics of n episodes, (n, d) in SI units."""
        ...

    def move(self, dynamics: Matrix, returns: Vector) -> None:
        """Learn from episodes that began after the last move, (n, d), and their returns (n,)."""
        ...


class Phase(Wire):
    """The part of a training between two moves of its curriculum."""

    steps: int  # of the environments, when it began
    distribution: dict[str, Any]
    mean_return: float | None = None  # of its episodes; none in the last phase, which no move ended


class Course:
    """A curriculum during one training, as its environments ask for it.

    It is moved when every environment has ended its share of episodes that began after the last
    move. Counting all episodes that end would count those that fail too often: they are short.
    Raises InvalidInput where the curriculum breaks its promises.
    """

    def __init__(self, curriculum: Curriculum, space: ParameterSpace, environments: int):
        if curriculum.episodes < 1:
            raise InvalidInput(
                f"a curriculum needs 1 episode or more for a move; given {curriculum.episodes}"
            )
        self._curriculum, self._space = curriculum, space
        self._share = -(-curriculum.episodes // environments)  # of each environment, per phase
        self._is_fresh = np.ones(environments, np.bool_)  # if its episode began after the move
        self._counts = np.zeros(environments, np.int64)  # fresh episodes that ended
        self._dynamics, self._returns = list[Matrix](), list[Vector]()
        self.phases: list[Phase] = []
        self._begin(steps=0)

    def sample(self, n: int, rng: np.random.Generator) -> Draws:
        draws, expected = self._curriculum.sample(n, rng), (n, len(self._space))
        values, least = draws.values, self._space.feasible_low
        if values.shape != expected:
            raise InvalidInput(
                f"the curriculum's draws must have the shape {expected}; given {values.shape}"
            )
        wrong = ~np.all(np.isfinite(values) & (values >= least), axis=1)
        if wrong.any():
            raise InvalidInput(
                f"the curriculum's draws must be finite and at least {least.tolist()}, for "
                f"{', '.join(self._space.names)}; given {values[wrong][0].tolist()}"
            )
        return draws

    def ended(self, rows: Indices, dynamics: Matrix, returns: Vector, steps: int) -> None:
        """Note episodes that ended in the environments `rows`, after `steps` of all of them."""
        counted = self._is_fresh[rows] & (self._counts[rows] < self._share)
        self._counts[rows[counted]] += 1
        self._dynamics.append(dynamics[counted])
        self._returns.append(returns[counted])
        self._is_fresh[rows] = True
        if np.all(self._counts == self._share):
            self._move(steps)
            self._is_fresh[:] = False
            self._is_fresh[rows] = True  # these begin anew

    def _move(self, steps: int) -> None:
        dynamics, returns = np.concatenate(self._dynamics), np.concatenate(self._returns)
        self._curriculum.move(dynamics, returns)
        mean = float(np.mean(returns))
        self.phases[-1] = self.phases[-1].model_copy(update={"mean_return": mean})
        self._begin(steps)

    def _begin(self, steps: int) -> None:
        distribution = self._curriculum.distribution
        check_space("the curriculum's distribution", distribution, self._space)
        self.phases.append(Phase(steps=steps, distribution=distribution.to_json()))
        self._counts[:] = 0
        self._dynamics, self._returns = [], []
