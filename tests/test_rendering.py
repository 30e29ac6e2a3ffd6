"""Films; skipped with a reason where nothing can draw."""

import os
import subprocess
import sys
from pathlib import Path

import gymnasium
import imageio.v3
import imageio_ffmpeg
import numpy as np
import pytest

from adr_service.errors import InvalidInput
from adr_service.simulation.batch import compiled
from adr_service.simulation.rendering import Camera, of_policy, of_recording, save
from adr_service.tasks.catalogue import BUILT_IN, get_task, hidden_of


@pytest.fixture(scope="module", autouse=True)
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


@pytest.mark.parametrize("task", BUILT_IN)
def test_a_picture_shows_the_robot_and_follows_its_state(task):
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


def test_a_film_shows_an_episode_as_fast_as_it_was(tmp_path):
    env = gymnasium.make("adr/RandomHopper-v0", render_mode="rgb_array")
    film = of_policy(env, lambda o: np.zeros((1, 3)), steps=10)
    env.close()
    assert len(film) == 11
    save(film, tmp_path / "film.gif", get_task("hopper"))
    assert len(imageio.v3.imread(tmp_path / "film.gif")) == 3  # every fifth
    assert imageio.v3.immeta(tmp_path / "film.gif")["duration"] == 5 * 8  # ms
    save(film, tmp_path / "film.mp4", get_task("hopper"))
    count, seconds = imageio_ffmpeg.count_frames_and_secs(tmp_path / "film.mp4")
    assert count == 11
    assert seconds == pytest.approx(11 * 0.008, abs=0.01)


def test_a_replay_with_true_dynamics_looks_like_the_recording(hopper_clean):
    task, hidden = get_task("hopper"), hidden_of("hopper", "vanilla")
    part = hopper_clean.first(20)
    for factor, same in ((1.0, True), (3.0, False)):
        film = of_recording(task, hidden.source, factor * hidden.values, part)
        assert len(film) == 21
        left, right = film[-1][:, :480], film[-1][:, 480:]
        sky = slice(0, 180)  # above the floor, which passes by on the right alone
        assert (np.any(left[sky] != right[sky], axis=2).mean() < 1e-3) == same


def test_the_command_films_a_recording(tmp_path, hopper_clean):
    data = tmp_path / "data.npz"
    data.write_bytes(hopper_clean.first(5).to_npz())
    done = adr("render", tmp_path / "film.gif", "--task", "hopper", "--data", data)
    assert done.returncode == 0, done.stdout + done.stderr
    assert "6 pictures" in done.stdout
    assert imageio.v3.imread(tmp_path / "film.gif").shape[-2:] == (960, 3)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["film.avi", "--task", "hopper", "--data", "x.npz"], ".gif or .mp4; given 'film.avi'"),
        (["film.gif", "--task", "hopper"], "give either --policy or --data"),
        (["film.gif", "--task", "hopper", "--data", "x.npz"], "x.npz cannot be read"),
        (["film.gif", "--task", "hopper", "--policy", "README.md"], "not the bytes of a policy"),
        (["no/film.gif", "--task", "hopper", "--data", "x.npz"], "there is no folder"),
    ],
)
def test_what_cannot_be_filmed_is_explained(arguments, message):
    done = adr("render", *arguments)
    assert done.returncode == 2
    assert message in done.stdout


def test_a_machine_that_cannot_draw_says_what_to_install(tmp_path, hopper_clean):
    data = tmp_path / "data.npz"
    data.write_bytes(hopper_clean.first(2).to_npz())
    film = tmp_path / "film.gif"
    done = adr("render", film, "--task", "hopper", "--data", data, MUJOCO_EGL_DEVICE_ID="99")
    assert done.returncode == 2
    assert "apt install libegl1" in done.stdout
    assert not film.exists()
