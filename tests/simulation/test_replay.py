"""Open-loop replay of recorded actions, and recordings that it refuses."""

import dataclasses

import numpy as np
import pytest

from adr_service.errors import InvalidInput
from adr_service.simulation.batch import Simulations
from adr_service.simulation.replay import Replay, check_recorded, check_replayable
from adr_service.simulation.rollout import run_episodes
from adr_service.tasks.catalogue import get_task, hidden_of, source_of
from adr_service.transitions import TransitionDataset
from tests import recordings
from tests.planted import ARM, SOURCE, recorded, waving_policy
from tests.recordings import HOPPER_MASSES_KG


class TestRefusedRecordings:
    """Recordings that are not of the task are refused before a method learns from them."""

    data = recordings.recording("arm", 20)

    @pytest.mark.parametrize(
        ("changes", "message"),
        [
            ({"columns": ("d", "c", "b", "a")}, "the data's columns are d, c, b, a; arm measures"),
            ({"actions": np.full((20, 2), 1.5)}, "20 actions lie outside the bounds of arm, .*1.5"),
            ({"dt": 0.5}, "0.5 s per step; arm has 0.02 s"),
        ],
    )
    def test_a_recording_that_does_not_fit_is_refused(self, changes, message):
        with pytest.raises(InvalidInput, match=message):
            check_recorded(get_task("arm"), dataclasses.replace(self.data, **changes))

    def test_a_bound_of_32_bits_is_within_it(self):
        humanoid = get_task("humanoid")
        most = np.float32(humanoid.action_high)
        assert np.any(most.astype(np.float64) > humanoid.action_high)
        data = recordings.recording("humanoid", 20)
        check_recorded(humanoid, dataclasses.replace(data, actions=np.tile(most, (20, 1))))

    def test_a_recording_of_another_robot_is_refused_with_both_widths(self):
        with pytest.raises(InvalidInput, match=r"4 observations and 2 actions; hopper measures 11"):
            check_recorded(get_task("hopper"), self.data)

    def test_columns_without_names_are_taken_for_the_tasks(self):
        unnamed = tuple(f"observation_{i}" for i in range(4))
        check_recorded(get_task("arm"), dataclasses.replace(self.data, columns=unnamed))


def taken(data, rows):
    """These rows of the data, as one episode."""
    arrays = (data.observations[rows], data.actions[rows], data.next_observations[rows])
    return TransitionDataset(*arrays, np.zeros(len(arrays[0])), data.dt, data.columns, "test")


class TestOrder:
    """Rows of an episode must follow one another where a replay is longer than one step."""

    data = recorded(waving_policy(), steps=200)
    shuffled = taken(data, np.random.default_rng(0).permutation(200))

    def test_shuffled_rows_are_refused_with_the_gap_and_the_change_of_a_step(self):
        message = (
            r"in shoulder_angle \[rad\], next observations differ .* by 0\.\d+, where a step "
            r"changes them by 0\.0\d+ .* an episode id of its own, or replay single steps"
        )
        with pytest.raises(InvalidInput, match=message):
            Replay(ARM, SOURCE, self.shuffled, 1, 5)

    @pytest.mark.parametrize("length", [2, None])
    def test_rows_with_others_left_out_between_them_are_refused(self, length):
        with pytest.raises(InvalidInput, match="follow one another"):
            check_replayable(ARM, taken(self.data, slice(None, None, 3)), length)

    def test_single_steps_need_no_order(self):
        replay = Replay(ARM, SOURCE, self.shuffled, 1, 1)
        assert len(replay.targets) == 200

    def test_stretches_with_ids_of_their_own_are_accepted(self):
        stretches = [taken(self.data, slice(first, first + 20)) for first in (140, 0, 80)]
        check_replayable(ARM, TransitionDataset.concatenate(stretches), None)

    def test_noise_on_next_observations_alone_is_accepted_where_nothing_moves(self):
        """Gaps and changes are the same noise, at a robot at rest."""
        rng, rest = np.random.default_rng(0), np.zeros((30, 4))
        noisy = dataclasses.replace(
            taken(self.data, slice(30)),
            observations=rest,
            next_observations=rng.normal(size=(30, 4)),
        )
        check_replayable(ARM, noisy, None)

    def test_rounding_to_32_bits_is_accepted_in_a_column_that_stands_still(self):
        drift = np.repeat(1 + 1e-7 * np.arange(30)[:, None], 4, axis=1)
        still = dataclasses.replace(
            taken(self.data, slice(30)), observations=drift, next_observations=drift
        )
        check_replayable(ARM, still, None)


class TestPublishedData:
    """DROPO's Hopper recordings, made with MuJoCo 2.1.0, replayed with the present one."""

    task, source = get_task("hopper"), source_of("hopper", "vanilla")
    truth = hidden_of("hopper", "vanilla").values

    def error(self, data, masses):
        replay = Replay(self.task, self.source, data, 1, 1)
        return replay.mean_squared_error(np.array([masses]))[0]

    def test_the_true_masses_are_the_published_ones(self):
        np.testing.assert_allclose(self.truth, HOPPER_MASSES_KG, atol=5e-9)

    def test_clean_data_are_reproduced_to_rounding(self, hopper_clean):
        assert self.error(hopper_clean, self.truth) < 1e-20

    def test_noisy_data_are_reproduced_to_their_noise(self, hopper_noisy):
        """11 columns of variance 1e-5; the mean square of 10,000 x 11 draws errs by 0.43 %."""
        expected, sampling = 11e-5, np.sqrt(2 / (10_000 * 11))
        assert self.error(hopper_noisy, self.truth) == pytest.approx(expected, rel=4 * sampling)

    def test_masses_wrong_by_a_tenth_are_seen(self, hopper_clean):
        assert self.error(hopper_clean, 1.1 * self.truth) > 1e-4

    def test_a_whole_episode_replays_from_its_first_state(self, hopper_clean):
        first = hopper_clean.split()[0]
        replay = Replay(self.task, self.source, first, 1, 500)
        assert replay.mean_squared_error(self.truth[None])[0] < 1e-15

    def test_noisy_data_can_be_replayed_for_whole_episodes(self, hopper_noisy):
        """Their noise is on next observations alone."""
        for episode in hopper_noisy.split():
            check_replayable(self.task, episode, None)

    def test_another_control_period_is_refused(self, hopper_clean):
        slow = dataclasses.replace(hopper_clean, dt=0.02)
        with pytest.raises(InvalidInput, match=r"0.02 s per step; hopper has 0.008 s"):
            Replay(self.task, self.source, slow, 1, 1)


def test_replay_predicts_what_a_rollout_recorded():
    """Closed loop, then open loop with the same actions and dynamics: nothing differs."""
    task, source = get_task("hopper"), source_of("hopper", "vanilla")
    dynamics = np.array([[3.0, 4.0, 2.0, 6.0]])
    simulations = Simulations(task, source, 1)
    simulations.set_dynamics(dynamics)

    def act(observations):
        return np.sin(10 * observations[:, :3])

    episode = run_episodes(task, simulations, act, task.initial(1, np.random.default_rng(0)), 40)
    n = int(episode.lengths[0])
    data = TransitionDataset(
        episode.observations[0, :n],
        episode.actions[0, :n],
        episode.observations[0, 1 : n + 1],
        np.zeros(n, dtype=np.int64),
        0.008,
        task.columns,
        "test",
    )
    replay = Replay(task, source, data, 1, 1)
    assert replay.mean_squared_error(dynamics)[0] < 1e-25  # x is put to 0, which rounds


def test_the_batch_size_changes_no_prediction():
    data, source = recordings.recording("arm", 20), source_of("arm", "vanilla")
    draws = np.random.default_rng(0).uniform(source.space.low, source.space.high, (7, 4))
    small, large = (Replay(get_task("arm"), source, data, n, 2) for n in (3, 7))
    np.testing.assert_array_equal(small.predict(draws), large.predict(draws))


def test_windows_start_where_they_stay_inside_their_episode():
    both = TransitionDataset.concatenate([recordings.recording("arm", 7) for _ in range(2)])
    replay = Replay(get_task("arm"), source_of("arm", "vanilla"), both, 1, 3)
    np.testing.assert_array_equal(replay.targets, both.next_observations[[2, 5, 9, 12]])
