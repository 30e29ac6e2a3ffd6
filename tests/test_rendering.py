"""Films; those tests that draw are skipped, with the reason, where nothing can."""

import os
import subprocess
import sys
from pathlib import Path

import gymnasium
import imageio.v3
import imageio_ffmpeg
import mujoco
import numpy as np
import pytest

from adr_service.errors import InvalidInput
from adr_service.simulation.model import compiled
from adr_service.simulation.rendering import Camera, of_policy, of_recording, save, stride_of
from adr_service.tasks.catalogue import BUILT_IN, get_task, hidden_of
from tests.recordings import recording


@pytest.fixture(scope="module")
def gl():
    try:
        Camera(compiled(get_task("arm").xml)).close()
    except InvalidInput as error:
        pytest.skip(str(error))


def adr(*arguments, **environment):
    return subprocess.run(
        [sys.executable, "-m", "api", *map(str, arguments)],
        capture_output=True,
        text=True,
        timeout=120,
        cwd=Path(__file__).parent.parent,
        env={**os.environ, "COLUMNS": "300", **environment},
        check=False,
    )


@pytest.mark.usefixtures("gl")
class TestDrawing:
    @pytest.mark.parametrize("task", BUILT_IN)
    def test_a_picture_shows_the_robot_and_follows_its_state(self, task):
        camera = Camera(compiled(BUILT_IN[task].task.xml))
        state = BUILT_IN[task].task.initial(1, np.random.default_rng(0))
        before = camera.picture(state.qpos[0])
        moved = state.qpos[0].copy()
        moved[-2:] += 0.5
        after, again = camera.picture(moved), camera.picture(state.qpos[0])
        np.testing.assert_array_equal(again, before)
        camera.close()
        assert before.shape == (352, 480, 3)
        assert np.any(before != after, axis=2).mean() > 5e-4

    def test_a_model_without_a_camera_is_seen_from_aside(self):
        body = '<body><freejoint/><geom size="0.3" rgba="1 0 0 1"/></body>'
        model = mujoco.MjModel.from_xml_string(
            f"<mujoco><worldbody>{body}<light/></worldbody></mujoco>"
        )
        camera = Camera(model)
        assert camera.picture(np.array([0.0, 0, 0, 1, 0, 0, 0])).std() > 0
        camera.close()

    def test_an_environment_draws_each_episodes_own_geometry(self):
        env = gymnasium.make("adr/RandomWalker2d-v0", render_mode="rgb_array").unwrapped
        env.reset(seed=0)
        short = env.render()
        env.reset(seed=0, options={"dynamics": {"torso_length": 1.0}})
        long = env.render()
        env.close()
        assert np.any(short != long, axis=2).mean() > 0.005

    # the film is written by another program, which JAX of earlier tests warns of
    @pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")
    @pytest.mark.filterwarnings("ignore:os.fork:RuntimeWarning")
    def test_a_film_shows_an_episode_as_fast_as_it_was(self, tmp_path):
        env = gymnasium.make("adr/RandomHopper-v0", render_mode="rgb_array")
        still = lambda o: np.zeros((1, 3))  # noqa: E731
        gif, mp4 = tmp_path / "film.gif", tmp_path / "film.mp4"
        assert save(of_policy(env, still, 10, every=5), gif, 5 * 0.008) == 3
        assert save(of_policy(env, still, 10), mp4, 0.008) == 11
        env.close()
        assert len(imageio.v3.imread(gif)) == 3
        assert imageio.v3.immeta(gif)["duration"] == 40  # ms
        count, seconds = imageio_ffmpeg.count_frames_and_secs(mp4)
        assert count == 11
        assert seconds == pytest.approx(11 * 0.008, abs=0.01)

    def test_a_replay_with_true_dynamics_looks_like_the_recording(self):
        task, hidden = get_task("arm"), hidden_of("arm", "vanilla")
        data = recording("arm", 20)
        for factor, same in ((1.0, True), (3.0, False)):
            dynamics = factor * hidden.values
            film = list(of_recording(task, hidden.source, dynamics, data, every=10))
            assert len(film) == 3
            left, right = film[-1][:, :480], film[-1][:, 480:]
            assert (np.any(left != right, axis=2).mean() < 1e-4) == same

    def test_the_command_films_a_recording(self, tmp_path):
        data = tmp_path / "data.npz"
        data.write_bytes(recording("hopper", 5).to_npz())
        done = adr("render", tmp_path / "film.gif", "--task", "hopper", "--data", data)
        assert done.returncode == 0, done.stdout + done.stderr
        assert "2 pictures" in done.stdout
        assert imageio.v3.imread(tmp_path / "film.gif").shape[-2:] == (960, 3)


@pytest.mark.parametrize(
    ("period_s", "stride"), [(0.008, 5), (0.05, 1), (0.015, 2), (0.02, 1), (0.001, 20), (0.1, 1)]
)
def test_a_gif_has_the_pictures_that_hundredths_of_seconds_can_time(tmp_path, period_s, stride):
    assert stride_of(tmp_path / "film.gif", period_s) == stride
    assert stride_of(tmp_path / "film.mp4", period_s) == 1


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["film.avi", "--task", "hopper", "--data", "DATA"], ".gif or .mp4; given 'film.avi'"),
        (["film.gif", "--task", "hopper"], "give either --policy or --data"),
        (["film.gif", "--task", "hopper", "--data", "x.npz"], "x.npz cannot be read"),
        (["film.gif", "--task", "hopper", "--policy", "README.md"], "not the bytes of a policy"),
        (["no/film.gif", "--task", "hopper", "--data", "DATA"], "there is no folder"),
        (["film.gif", "--task", "walker2d", "--data", "DATA"], "walker2d measures 17 and takes 6"),
        (["film.gif", "--task", "hopper", "--data", "DATA", "--episode", "1"], "episodes 0 to 0"),
        (
            ["film.gif", "--task", "hopper", "--data", "DATA", "--set", "leg=1"],
            "accepted: torso_mass",
        ),
        (
            ["film.gif", "--task", "hopper", "--data", "DATA", "--steps", "0"],
            "greater than or equal to 1",
        ),
    ],
)
def test_what_cannot_be_filmed_is_explained(tmp_path, arguments, message):
    data = tmp_path / "data.npz"
    data.write_bytes(recording("hopper", 3).to_npz())
    done = adr("render", *(str(data) if a == "DATA" else a for a in arguments))
    assert done.returncode == 2
    assert message in done.stdout + done.stderr


@pytest.mark.parametrize(
    "environment", [{"MUJOCO_EGL_DEVICE_ID": "99", "MUJOCO_GL": ""}, {"MUJOCO_GL": "glfw"}]
)
def test_a_machine_that_cannot_draw_says_what_to_install(tmp_path, environment):
    data, film = tmp_path / "data.npz", tmp_path / "film.gif"
    data.write_bytes(recording("hopper", 2).to_npz())
    for display in ("DISPLAY", "WAYLAND_DISPLAY"):
        environment = environment | {display: ""}
    done = adr("render", film, "--task", "hopper", "--data", data, **environment)
    assert done.returncode == 2
    assert "apt install libegl1" in done.stderr
    assert not film.exists()
