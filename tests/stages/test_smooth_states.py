"""Smoothing as a stage."""

import pytest

from adr_service.errors import InvalidInput
from adr_service.stages.base import compute
from adr_service.stages.smooth_states import SmoothStates
from adr_service.transitions import TransitionDataset
from tests.planted import SPACE, recorded, waving_policy
from tests.recordings import recording
from tests.stages.examples import Speed

DATA = recorded(waving_policy(), steps=20)
STAGE = SmoothStates(task="arm", variant="vanilla", seed=0, data=DATA.to_npz())


@pytest.fixture(scope="module")
def smoothed():
    return STAGE.read(compute(STAGE))


def test_it_gives_a_recording_of_the_same_transitions(smoothed):
    data = TransitionDataset.from_npz(smoothed.data)
    assert data.next_observations.tolist() == DATA.next_observations.tolist()
    assert len(smoothed.parameters) == len(SPACE)
    assert len(smoothed.sensor_std) == DATA.observations.shape[1]


def test_an_unread_column_has_no_deviation():
    data = recording("hopper", 10).to_npz()
    stage = SmoothStates(task="hopper", variant="vanilla", seed=0, data=data)
    assert stage.read(compute(stage)).sensor_std[0] is None


def test_more_data_cost_more():
    longer = recorded(waving_policy(), steps=40).to_npz()
    more = SmoothStates(task="arm", variant="vanilla", seed=0, data=longer)
    assert more.cost(Speed()).seconds == 2 * STAGE.cost(Speed()).seconds


def test_a_stand_in_has_as_many_transitions():
    assert len(TransitionDataset.from_npz(STAGE.stand_in().data)) == len(DATA)


def test_data_that_are_no_recording_are_refused():
    stage = SmoothStates(task="arm", variant="vanilla", seed=0, data=b"measured")
    with pytest.raises(InvalidInput, match=r"not a readable \.npz"):
        compute(stage)
