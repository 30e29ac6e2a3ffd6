"""Pictures and films of simulated robots, without a display.

film = of_policy(env, policy.act, steps=200)          # env with render_mode="rgb_array"
film = of_recording(task, source, dynamics, data)     # recorded | replayed
save(film, Path("episode.gif"), task)
"""

import os
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import imageio.v3
import mujoco
import numpy as np
from numpy.typing import NDArray

from adr_service.arrays import Matrix, Vector
from adr_service.errors import InvalidInput
from adr_service.simulation.batch import Simulations, control_period
from adr_service.tasks.base import Source, State, Task
from adr_service.transitions import TransitionDataset

Picture = NDArray[np.uint8]  # (height, width, 3)


class Camera:
    """Draws one model from its first camera, offscreen."""

    def __init__(self, model: mujoco.MjModel, width: int = 480, height: int = 352):
        self._model, self._data = model, mujoco.MjData(model)
        self._context = _context(width, height)
        self._context.make_current()
        self._size = mujoco.MjrRect(0, 0, width, height)
        self._scene = mujoco.MjvScene(model, maxgeom=1000)
        self._options, self._view = mujoco.MjvOption(), mujoco.MjvCamera()
        self._view.type, self._view.fixedcamid = mujoco.mjtCamera.mjCAMERA_FIXED, 0
        self._renderer = mujoco.MjrContext(model, mujoco.mjtFontScale.mjFONTSCALE_100)
        mujoco.mjr_setBuffer(mujoco.mjtFramebuffer.mjFB_OFFSCREEN, self._renderer)

    def picture(self, qpos: Vector) -> Picture:
        self._data.qpos[:] = qpos
        mujoco.mj_forward(self._model, self._data)
        self._context.make_current()
        everything = mujoco.mjtCatBit.mjCAT_ALL
        mujoco.mjv_updateScene(
            self._model, self._data, self._options, None, self._view, everything, self._scene
        )
        mujoco.mjr_render(self._size, self._scene, self._renderer)
        picture = np.empty((self._size.height, self._size.width, 3), np.uint8)
        mujoco.mjr_readPixels(picture, None, self._size, self._renderer)
        return np.flipud(picture)

    def close(self) -> None:
        self._context.make_current()
        self._renderer.free()
        self._context.free()


def of_policy(
    env: Any,
    act: Callable[[Matrix], Matrix],
    steps: int,
    seed: int = 0,
    options: dict[str, Any] | None = None,
) -> list[Picture]:
    """An episode of a policy in a Gymnasium environment that renders, until it ends."""
    observation, _ = env.reset(seed=seed, options=options)
    pictures = [env.render()]
    for _ in range(steps):
        observation, _, terminated, truncated, _ = env.step(act(observation[None])[0])
        pictures.append(env.render())
        if terminated or truncated:
            break
    return pictures


def of_recording(
    task: Task, source: Source, dynamics: Vector, data: TransitionDataset
) -> list[Picture]:
    """A recorded episode on the left; replayed open loop from its first state on the right.

    What is not measured (how far the robot has come) is not shown on the left.
    """
    simulations = Simulations(task, source, 1)
    simulations.set_dynamics(dynamics[None])
    recorded = task.state(np.concatenate([data.observations[:1], data.next_observations]))
    simulations.set_state(State(recorded.qpos[:1], recorded.qvel[:1]))
    replayed = [simulations.state.qpos[0]]
    for action in data.actions:
        simulations.step(action)
        replayed.append(simulations.state.qpos[0])
    camera = Camera(simulations.model(0))
    try:
        return [
            np.concatenate([camera.picture(left), camera.picture(right)], axis=1)
            for left, right in zip(recorded.qpos, replayed, strict=True)
        ]
    finally:
        camera.close()


def save(pictures: Sequence[Picture], path: Path, task: Task) -> None:
    """Write a film, `.gif` or `.mp4`, that runs as fast as the robot.

    A GIF counts time in hundredths of a second, two at least, so it leaves pictures out.
    """
    check_name(path)
    period_s = control_period(task)
    if path.suffix == ".gif":
        hundredths = {k: 100 * k * period_s for k in range(1, 11) if 100 * k * period_s >= 2}
        stride = min(hundredths, key=lambda k: (abs(hundredths[k] % 1 - 0.5) < 0.49, k))
        imageio.v3.imwrite(path, list(pictures[::stride]), duration=10 * hundredths[stride], loop=0)
    else:
        imageio.v3.imwrite(path, np.array(pictures), fps=1 / period_s, plugin="FFMPEG")


def check_name(path: Path) -> None:
    """Refuse what is no film's name, before anything is drawn."""
    if path.suffix not in (".gif", ".mp4"):
        raise InvalidInput(f"a film ends in .gif or .mp4; given {path.name!r}")
    if not path.absolute().parent.is_dir():
        raise InvalidInput(f"there is no folder {path.absolute().parent}")


def _context(width: int, height: int) -> Any:
    """An OpenGL context: what MUJOCO_GL names, and EGL where it names nothing."""
    chosen = os.environ.get("MUJOCO_GL", "egl")
    try:
        if chosen == "egl":
            from mujoco.egl import GLContext
        else:
            from mujoco import GLContext
        return GLContext(width, height)
    # PyOpenGL raises many kinds where a library is missing or finds no device
    except Exception as error:
        raise InvalidInput(
            f"nothing to draw with (MUJOCO_GL={chosen}): {error!r}. Install EGL (Debian and "
            "Ubuntu: apt install libegl1 libgl1-mesa-dri), or set MUJOCO_GL to osmesa or glfw "
            "before Python starts"
        ) from error
