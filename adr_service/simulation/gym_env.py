"""The tasks as Gymnasium environments, one simulation each.

    import adr_service
    env = gymnasium.make("adr/RandomHopper-v0")
    observation, info = env.reset(seed=0, options={"dynamics": {"torso_mass": 4.2}})

`adr/RandomX-v0` has the true dynamics, `adr/RandomXNoisy-v0` adds sensor noise, and
`adr/RandomXUnmodeled-v0` is the simulator with some wrong parameters. With a distribution, an
environment draws new dynamics at every reset. Training uses `vec_env`, which is faster. An
environment made by hand, `RandomizedEnv("hopper")`, has no time limit; those made by id have one.
"""

import math
from collections.abc import Mapping
from numbers import Real
from typing import Any, cast

import gymnasium
import numpy as np

from adr_service.arrays import Vector
from adr_service.distributions import Distribution, distribution_from_json
from adr_service.errors import InvalidInput
from adr_service.parameters import ParameterSpace
from adr_service.simulation.batch import Simulations, control_period
from adr_service.simulation.rendering import Camera
from adr_service.simulation.rollout import check_rewards
from adr_service.tasks.base import State
from adr_service.tasks.catalogue import get_task, variant_of


class RandomizedEnv(gymnasium.Env[np.ndarray, np.ndarray]):
    """One simulation of a task's variant.

    `distribution` is the JSON document of an inferred distribution over `env.unwrapped.space`, or
    the file of `adr results --distribution` that has it; without one the dynamics are true. A
    diverged simulation ends its episode with an observation
    of zeros, no reward, and `info["diverged"]`.
    """

    metadata: dict[str, Any] = {"render_modes": ["rgb_array"]}  # noqa: RUF012 (Gymnasium's own)

    def __init__(
        self,
        task: str,
        variant: str = "vanilla",
        distribution: Mapping[str, Any] | None = None,
        render_mode: str | None = None,
    ):
        if render_mode not in (None, "rgb_array"):
            raise InvalidInput(f"render_mode {render_mode!r} is not one of None, 'rgb_array'")
        self._task, pair = get_task(task), variant_of(task, variant)
        self.space, self._truth = pair.source.space, pair.truth
        self._noise = np.sqrt(pair.hidden.noise_variance)
        self._frozen = set(pair.hidden.source.space.names) - set(self.space.names)
        self._distribution = _distribution_of(task, self.space, distribution)
        self._simulations = Simulations(self._task, pair.source, 1)
        self._simulations.set_dynamics(self._truth[None])
        self._camera: Camera | None = None
        box = gymnasium.spaces.Box
        self.observation_space = box(-np.inf, np.inf, (len(self._task.columns),), np.float64)
        low, high = self._task.action_low, self._task.action_high
        self.action_space = box(low.astype(np.float32), high.astype(np.float32))
        self.render_mode = render_mode
        rate = round(1 / self.dt)
        self.metadata = {**self.metadata, "render_fps": rate}

    @property
    def dt(self) -> float:
        """Seconds between two actions."""
        return control_period(self._task)

    @property
    def dynamics(self) -> dict[str, float]:
        """The parameters of this episode by name, in SI units."""
        return dict(zip(self.space.names, self._simulations.dynamics[0].tolist(), strict=True))

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[np.ndarray, dict[str, Any]]:
        """Start an episode; `options["dynamics"]` sets some or all parameters by name."""
        given = self._dynamics_in(options)
        super().reset(seed=seed)
        self._drop_camera()  # it draws one episode's model
        self._simulations.set_dynamics(self._drawn(given)[None])
        self._simulations.set_state(self._task.initial(1, self.np_random))
        return self._observe(self._simulations.state), {"dynamics": self.dynamics}

    def step(self, action: np.ndarray) -> tuple[np.ndarray, float, bool, bool, dict[str, Any]]:
        task, simulations = self._task, self._simulations
        before, action = simulations.state, self._finite_action(action)
        simulations.step(action)
        after = simulations.state
        if simulations.diverged[0]:
            nothing = np.zeros(len(task.columns))
            return nothing, 0.0, True, False, {"diverged": True}
        rewards = task.reward(before, action[None], after)
        check_rewards(task, rewards)
        return self._observe(after), float(rewards[0]), bool(task.terminated(after)[0]), False, {}

    # Gymnasium's own type allows lists of frames too, which we never return
    def render(self) -> np.ndarray | None:  # type: ignore[override]
        """The picture of the present state, (h, w, 3) bytes; None without a render mode."""
        if self.render_mode is None:
            return None
        if self._camera is None:
            self._camera = Camera(self._simulations.model(0))
        return self._camera.picture(self._simulations.state.qpos[0])

    def close(self) -> None:
        self._drop_camera()

    def _drop_camera(self) -> None:
        if self._camera is not None:
            self._camera.close()
            self._camera = None

    def _observe(self, state: State) -> np.ndarray:
        observation = np.array(self._task.observe(state)[0])  # perhaps of the state itself
        if self._noise > 0:
            measured = self._task.measured
            observation[:measured] += self._noise * self.np_random.standard_normal(measured)
        return observation

    def _finite_action(self, action: Any) -> Vector:
        """The action as finite numbers (a,); raises InvalidInput for anything else."""
        shape = self.action_space.shape
        try:
            numbers = np.asarray(action, dtype=np.float64)
        except (TypeError, ValueError, OverflowError):
            numbers = None
        if numbers is None or numbers.shape != shape or not np.isfinite(numbers).all():
            raise InvalidInput(f"an action must be finite, of shape {shape}; given {action!r}")
        return numbers

    def _dynamics_in(self, options: Any) -> dict[str, float]:
        """The parameters that reset options set, by name."""
        if not (options is None or isinstance(options, Mapping)):
            raise InvalidInput(f"reset options must be values by name; given {options!r}")
        options = cast(Mapping[Any, Any], options or {})
        unknown = [name for name in options if name != "dynamics"]
        if unknown:
            raise InvalidInput(f"reset options {unknown} are not known; known: dynamics")
        given = options.get("dynamics", {})
        if not isinstance(given, Mapping):
            raise InvalidInput(f"dynamics must be values by name; given {given!r}")
        return {name: self._feasible_value(name, value) for name, value in given.items()}

    def _feasible_value(self, name: Any, value: Any) -> float:
        """The value of a parameter; raises InvalidInput where the parameter cannot have it."""
        if not isinstance(name, str):
            raise InvalidInput(f"dynamics must be values by name; given the name {name!r}")
        if name in self._frozen:
            raise InvalidInput(f"{name} is frozen in this variant")
        least = self.space.feasible_low[self.space.index(name)]
        try:
            is_number = not isinstance(value, bool) and isinstance(value, Real)
            number = float(value) if is_number else math.nan
        except OverflowError:
            number = math.inf
        if not least <= number < math.inf:
            raise InvalidInput(f"{name} must be a finite float from {least:g} up; given {value!r}")
        return number

    def _drawn(self, given: Mapping[str, float]) -> Vector:
        """The parameters of an episode (d,): drawn, but for those that are given."""
        values = self._truth
        if self._distribution is not None:
            values = self._distribution.sample(1, self.np_random).values[0]
        values = values.copy()
        for name, value in given.items():
            values[self.space.index(name)] = value
        return values


def _distribution_of(task: str, space: ParameterSpace, document: Any) -> Distribution | None:
    """The distribution of a JSON document; None without one.

    Raises InvalidInput for the file of another task, or of a variant with other search bounds, in
    whose coordinates the same numbers are other dynamics.
    """
    if document is None:
        return None
    if not isinstance(document, Mapping):
        raise InvalidInput(
            f"distribution must be the JSON document of one, or None; given {document!r}"
        )
    given = cast(Mapping[str, Any], document)
    if "distributions" in given:
        given = _only_one(task, space, given)
    return distribution_from_json(space, dict(given))


def _only_one(task: str, space: ParameterSpace, file: Mapping[str, Any]) -> Mapping[str, Any]:
    """The distribution in a file of `adr results --distribution`."""
    origin = str(file.get("task")), str(file.get("variant"))
    if origin[0] != task or variant_of(*origin).source.space != space:
        raise InvalidInput(
            f"distribution is of {' '.join(origin)}, whose parameters or search bounds are not "
            f"those of this variant of {task}"
        )
    if file.get("extension"):
        raise InvalidInput(
            f"distribution is of {' '.join(origin)} with effects {file['extension']}, which this "
            "environment lacks"
        )
    found = file["distributions"]
    if not isinstance(found, list) or not all(isinstance(one, Mapping) for one in found):
        raise InvalidInput(f"distributions must be a list of documents; given {found!r}")
    if len(found) != 1:
        raise InvalidInput(f"{len(found)} distributions are given; choose one of them")
    return cast(Mapping[str, Any], found[0])
