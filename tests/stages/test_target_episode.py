"""Robots' episodes: uploads of them, and what they cost a run."""

from dataclasses import replace

import numpy as np
import pytest

from adr_service.errors import InvalidInput
from adr_service.npz import write_arrays
from adr_service.stages.base import compute
from adr_service.stages.target_episode import read_episode
from adr_service.tasks.catalogue import get_task
from adr_service.transitions import TransitionDataset
from tests.planted import recorded, waving_policy
from tests.stages.examples import Speed, episode

ARM = get_task("arm")
REWARDS = np.linspace(0.0, 1.0, 10)


@pytest.fixture(scope="module")
def data():
    """An arm's episode of ten transitions."""
    return recorded(waving_policy(), steps=10)


def upload(data, **changes):
    """An upload's bytes; arrays that are None are left out."""
    arrays = {**data.to_arrays(), "rewards": REWARDS, **changes}
    return write_arrays({name: array for name, array in arrays.items() if array is not None})


def test_an_upload_is_read_as_its_data_and_the_sum_of_its_rewards(data):
    result = read_episode("arm", 10, upload(data))
    assert result.earned == pytest.approx(REWARDS.sum())
    assert result.transitions == 10
    read = TransitionDataset.from_npz(result.data)
    np.testing.assert_array_equal(read.observations, data.observations)


def test_a_shorter_episode_is_accepted(data):
    short = upload(data.first(4), rewards=REWARDS[:4])
    assert read_episode("arm", 10, short).transitions == 4


@pytest.mark.parametrize(
    "rewards", [np.arange(10), np.ones(10, dtype=np.float32), np.ones(10, dtype=np.uint8)], ids=str
)
def test_rewards_may_be_any_numbers(data, rewards):
    assert read_episode("arm", 10, upload(data, rewards=rewards)).earned == rewards.sum()


@pytest.mark.parametrize(
    ("rewards", "given"),
    [
        (None, "nothing"),
        (np.ones(9), r"float64 \(9,\)"),
        (np.ones((10, 1)), r"float64 \(10, 1\)"),
        (np.float64(1.0), r"float64 \(\)"),
        (np.ones(10, dtype=bool), r"bool \(10,\)"),
        (np.array(["1"] * 10), r"<U1 \(10,\)"),
    ],
)
def test_rewards_of_another_form_are_refused(data, rewards, given):
    with pytest.raises(InvalidInput, match=rf"rewards must be \(10,\) numbers; given {given}"):
        read_episode("arm", 10, upload(data, rewards=rewards))


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf, 1e308])
def test_rewards_whose_sum_is_not_finite_are_refused(data, value):
    with pytest.raises(InvalidInput, match="must be finite"):
        read_episode("arm", 10, upload(data, rewards=np.full(10, value)))


def test_an_episode_that_is_longer_than_its_task_is_refused(data):
    with pytest.raises(InvalidInput, match="asks for 9 transitions at most; given 10"):
        read_episode("arm", 9, upload(data))


def test_two_episodes_are_refused(data):
    two = upload(data, episodes=np.repeat([0, 1], 5), terminals=None)
    with pytest.raises(InvalidInput, match="a task is one episode; the data have 2"):
        read_episode("arm", 10, two)


def test_rows_that_do_not_follow_one_another_are_refused(data):
    order = np.random.default_rng(0).permutation(10)
    rows = ("observations", "actions", "next_observations")
    shuffled = {name: getattr(data, name)[order] for name in rows}
    with pytest.raises(InvalidInput, match="rows do not follow one another: in shoulder_angle"):
        read_episode("arm", 10, upload(data, **shuffled))


def test_an_episode_of_another_task_is_refused(data):
    message = r"the data have 4 observations and 2 actions; hopper measures \d+ and takes 3"
    with pytest.raises(InvalidInput, match=message):
        read_episode("hopper", 10, upload(data))


def test_an_episode_at_another_rate_is_refused(data):
    with pytest.raises(InvalidInput, match=r"0\.1 s per step; arm has 0\.02 s"):
        read_episode("arm", 10, upload(data, dt=np.array(0.1)))


def test_an_array_that_no_episode_has_is_refused_with_the_accepted_names(data):
    with pytest.raises(InvalidInput, match=r"speed.*accepted: .*rewards\.npy"):
        read_episode("arm", 10, upload(data, speed=np.ones(10)))


def test_arrays_much_longer_than_the_episode_are_not_even_read(data):
    with pytest.raises(InvalidInput, match=r"rewards\.npy has 1001 rows; accepted are 1000"):
        read_episode("arm", 10, upload(data, rewards=np.ones(1001)))


def test_it_cannot_be_computed_here():
    with pytest.raises(InvalidInput, match="needs the service"):
        compute(episode())


@pytest.mark.parametrize("purpose", ["rollout", "return", "evaluation"])
def test_every_purpose_but_evaluation_is_metered(purpose):
    cost = replace(episode(), purpose=purpose).cost(Speed())
    assert cost.target_transitions == (0 if purpose == "evaluation" else 10)


def test_it_takes_the_robots_own_time_on_any_core():
    slow, fast = (episode().cost(Speed(rate)).seconds for rate in (1.0, 1e6))
    assert slow == fast == pytest.approx(10 * 0.02)


def test_a_stand_in_would_be_accepted_as_an_upload():
    stand_in = episode().stand_in()
    arrays = TransitionDataset.from_npz(stand_in.data).to_arrays()
    read = read_episode("arm", 10, write_arrays({**arrays, "rewards": np.zeros(10)}))
    assert read == stand_in
