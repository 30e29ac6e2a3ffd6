"""Pictures and films of simulated robots, without a display.

every = stride_of(path, period_s)                               # a GIF leaves pictures out
pictures = of_policy(env, policy.act, 200, every=every)         # env with render_mode="rgb_array"
pictures = beside(pictures, others)                             # two episodes
pictures = of_recording(task, source, dynamics, data, every)    # recorded | replayed
count = save(pictures, path, every * period_s)
"""

import copy
import math
import os
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import imageio
import mujoco
import numpy as np
from numpy.typing import NDArray

from adr_service.arrays import Matrix, Vector
from adr_service.errors import InvalidInput
from adr_service.simulation.batch import Simulations
from adr_service.simulation.replay import check_recorded
from adr_service.tasks.base import Source, State, Task
from adr_service.transitions import TransitionDataset

Picture = NDArray[np.uint8]  # (height, width, 3)
_SHADOWS = 1024  # pixels of the shadows' map: as good as MuJoCo's 4096 here, and a third faster
_GIF_TICK_S, _LONGEST_STRIDE = 0.01, 100  # GIFs count hundredths of a second; players need two


class Camera:
    """Draws one model offscreen, from its first camera or, without one, from the side."""

    def __init__(self, model: mujoco.MjModel, width: int = 480, height: int = 352):
        self._model, self._data = model, mujoco.MjData(model)
        self._size = mujoco.MjrRect(0, 0, width, height)
        self._scene = mujoco.MjvScene(model, maxgeom=1000)
        self._options, self._view = mujoco.MjvOption(), mujoco.MjvCamera()
        if model.ncam:
            self._view.type, self._view.fixedcamid = mujoco.mjtCamera.mjCAMERA_FIXED, 0
        else:
            mujoco.mjv_defaultFreeCamera(model, self._view)
        self._context, self._renderer = _open(model, width, height)

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
    *,
    every: int = 1,
    seed: int = 0,
    options: dict[str, Any] | None = None,
) -> Iterator[Picture]:
    """Pictures of a policy's episode in a Gymnasium environment with a render mode."""
    observation, _ = env.reset(seed=seed, options=options)
    yield env.render()
    for step in range(1, steps + 1):
        observation, _, terminated, truncated, info = env.step(act(observation[None])[0])
        if info.get("diverged"):
            raise InvalidInput(f"the simulation diverged at step {step}")
        if step % every == 0:
            yield env.render()
        if terminated or truncated:
            return


def beside(left: Iterable[Picture], right: Iterable[Picture]) -> Iterator[Picture]:
    """Two films side by side; whichever ends first shows its last picture until the other ends."""
    films = [iter(left), iter(right)]
    shown = [next(film) for film in films]
    while True:
        yield np.concatenate(shown, axis=1)
        following = [next(film, None) for film in films]
        if all(picture is None for picture in following):
            return
        shown = [new if new is not None else old for new, old in zip(following, shown, strict=True)]


def of_recording(
    task: Task, source: Source, dynamics: Vector, data: TransitionDataset, every: int = 1
) -> Iterator[Picture]:
    """Pictures of a recorded episode on the left and its open-loop replay on the right.

    The left shows measured values alone, so not how far the robot has come.
    """
    check_recorded(task, data)
    simulations = Simulations(task, source, 1)
    simulations.set_dynamics(dynamics[None])
    recorded = task.state(np.concatenate([data.observations[:1], data.next_observations]))
    simulations.set_state(State(recorded.qpos[:1], recorded.qvel[:1]))
    camera = Camera(simulations.model(0))
    try:
        for step in range(len(data) + 1):
            if step > 0:
                simulations.step(data.actions[step - 1])
            if simulations.diverged[0]:
                raise InvalidInput(f"the replay diverged at step {step}")
            if step % every == 0:
                replayed = simulations.state.qpos[0]
                both = [camera.picture(qpos) for qpos in (recorded.qpos[step], replayed)]
                yield np.concatenate(both, axis=1)
    finally:
        camera.close()


def stride_of(path: Path, period_s: float, most_fps: float | None = None) -> int:
    """Control steps between two pictures of a film, so that it plays in real time.

    An `.mp4` has every step, or `most_fps` pictures a second at most. Raises InvalidInput if the
    path cannot be a film's, before anything is drawn.
    """
    if path.suffix not in (".gif", ".mp4"):
        raise InvalidInput(f"a film ends in .gif or .mp4; given {path.name!r}")
    if not path.absolute().parent.is_dir():
        raise InvalidInput(f"there is no folder {path.absolute().parent}")
    if path.suffix == ".mp4":
        return 1 if most_fps is None else max(1, math.ceil(1 / (most_fps * period_s)))
    if most_fps is not None:
        raise InvalidInput(
            f"only an .mp4 can have a limit of pictures a second; given {path.name!r}"
        )
    ticks = np.arange(1, _LONGEST_STRIDE + 1) * period_s / _GIF_TICK_S
    error = np.where(ticks < 1.99, np.inf, np.abs(ticks - np.round(ticks)) / ticks)
    good = np.flatnonzero(error <= max(1e-6, error.min()))
    return int(good[0]) + 1


def save(pictures: Iterable[Picture], path: Path, period_s: float) -> int:
    """Write a film with `period_s` between pictures; returns the number of pictures.

    If it is interrupted, what was at `path` before stays.
    """
    # beside it, under the same name, whose ending says the format
    with TemporaryDirectory(dir=path.parent, ignore_cleanup_errors=True) as folder:
        count = _save(pictures, Path(folder) / path.name, period_s)
        (Path(folder) / path.name).replace(path)
    return count


def _save(pictures: Iterable[Picture], path: Path, period_s: float) -> int:
    if path.suffix == ".gif":
        shown = list(pictures)
        imageio.v3.imwrite(path, shown, duration=1000 * period_s, loop=0)
        return len(shown)
    count = 0
    film: Any = imageio.v2.get_writer(path, fps=1 / period_s)
    with film:
        for picture in pictures:
            film.append_data(picture)
            count += 1
    return count


def _open(model: mujoco.MjModel, width: int, height: int) -> tuple[Any, Any]:
    """An OpenGL context by MUJOCO_GL, or by EGL if that is unset, and a renderer in it."""
    chosen = os.environ.get("MUJOCO_GL") or "egl"
    try:
        if chosen == "egl":
            from mujoco.egl import GLContext
        else:
            from mujoco import GLContext
        context = GLContext(width, height)
        context.make_current()
        drawn = copy.copy(model)
        drawn.vis.quality.shadowsize = _SHADOWS
        renderer = mujoco.MjrContext(drawn, mujoco.mjtFontScale.mjFONTSCALE_100)
    # PyOpenGL and MuJoCo raise many kinds of errors if a library or a device is missing
    except Exception as error:
        raise InvalidInput(
            f"nothing to draw with (MUJOCO_GL={chosen}): {error!r}. Install EGL (Debian and "
            "Ubuntu: apt install libegl1 libgl1-mesa-dri) and leave MUJOCO_GL unset"
        ) from error
    mujoco.mjr_setBuffer(mujoco.mjtFramebuffer.mjFB_OFFSCREEN, renderer)
    return context, renderer
