"""Pictures and films; tests that draw are skipped, with the reason, where nothing can."""

import gymnasium
import imageio.v3
import imageio_ffmpeg
import mujoco
import numpy as np
import pytest

from adr_service.errors import InvalidInput
from adr_service.simulation.model import compiled
from adr_service.simulation.rendering import (
    Camera,
    beside,
    of_policy,
    of_recording,
    save,
    stride_of,
)
from adr_service.tasks.catalogue import BUILT_IN, get_task, hidden_of
from tests.drawing import drawing
from tests.recordings import recording

__all__ = ["drawing"]


@pytest.mark.usefixtures("drawing")
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

    def test_a_model_without_a_camera_is_seen_from_the_side(self):
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
    def test_a_film_plays_in_real_time(self, tmp_path):
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


def test_a_film_that_is_interrupted_leaves_no_file(tmp_path):
    def pictures():
        yield np.zeros((64, 64, 3), dtype=np.uint8)
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        save(pictures(), tmp_path / "a.mp4", 0.02)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("period_s", "stride"), [(0.008, 5), (0.05, 1), (0.015, 2), (0.02, 1), (0.001, 20), (0.1, 1)]
)
def test_a_gif_leaves_out_pictures_until_hundredths_of_seconds_fit(tmp_path, period_s, stride):
    assert stride_of(tmp_path / "film.gif", period_s) == stride
    assert stride_of(tmp_path / "film.mp4", period_s) == 1
    every = stride_of(tmp_path / "film.mp4", period_s, most_fps=25)
    assert 1 / 25 <= every * period_s < 1 / 25 + period_s


def test_pictures_a_second_of_a_gif_are_not_to_be_chosen(tmp_path):
    with pytest.raises(InvalidInput, match=r"limit of pictures a second; given 'film\.gif'"):
        stride_of(tmp_path / "film.gif", 0.05, most_fps=5)


def test_of_two_films_the_shorter_one_shows_its_last_picture_until_the_other_ends():
    short = [np.full((2, 3, 3), value, np.uint8) for value in (1, 2)]
    long = [np.full((2, 3, 3), value, np.uint8) for value in (7, 8, 9)]
    both = list(beside(short, long))
    assert [(int(p[0, 0, 0]), int(p[0, -1, 0])) for p in both] == [(1, 7), (2, 8), (2, 9)]
    assert both[0].shape == (2, 6, 3)
