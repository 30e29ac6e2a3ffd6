"""Stand-ins for results: of the right form, and as different as their digests."""

import numpy as np
import pytest

from adr_service.distributions import at_resolution
from adr_service.simulation.batch import control_period
from adr_service.simulation.replay import check_recorded
from adr_service.stages.stand_ins import gaussian, trajectory
from adr_service.tasks.catalogue import get_task, source_of
from adr_service.transitions import TransitionDataset
from tests.tasks.cases import CASES, IDS

SPACE = source_of("arm", "vanilla").space


@pytest.mark.parametrize(("task", "variant"), CASES, ids=IDS)
def test_a_belief_lies_inside_the_space_of_its_variant(task, variant):
    space = source_of(task.name, variant).space
    belief = gaussian(space, "digest")
    assert np.all(space.low <= belief.mean)
    assert np.all(belief.mean <= space.high)
    assert np.all(belief.std > 0)


def test_beliefs_of_two_digests_are_distinct():
    one, other, again = (gaussian(SPACE, digest).to_json() for digest in ("a", "b", "a"))
    assert one == again
    assert one != other


def test_no_resolution_makes_two_beliefs_one_point():
    """A plan told too few trainings where the spec's resolution was coarse."""
    beliefs = [at_resolution(gaussian(SPACE, str(n)), 1.0).to_json() for n in range(50)]
    assert all(belief not in beliefs[:n] for n, belief in enumerate(beliefs))


@pytest.mark.parametrize("task", ["arm", "hopper", "humanoid"])
def test_a_trajectory_is_one_recorded_episode_of_the_task(task):
    data = TransitionDataset.from_npz(trajectory(task, 7, "digest"))
    check_recorded(get_task(task), data)
    assert len(data) == 7
    assert data.episode_count == 1
    assert data.dt == control_period(get_task(task))


def test_trajectories_of_two_digests_have_other_bytes_and_the_same_motion():
    one, other, again = (trajectory("arm", 3, digest) for digest in ("a", "b", "a"))
    assert one == again
    assert one != other
    motions = [TransitionDataset.from_npz(each).observations for each in (one, other)]
    np.testing.assert_array_equal(*motions)
