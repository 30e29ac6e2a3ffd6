import numpy as np

from adr_service.methods.udr import UdrSettings
from adr_service.programs.udr import boxes_of
from adr_service.stages.local import LocalStages
from tests.programs.smoke import iterations, smoke


def test_udr_trains_one_policy_per_box_and_visits_the_target_for_evaluation_alone():
    stages = LocalStages()
    (event,) = iterations(smoke("udr"), stages)
    assert len(event.policies) == len(event.returns) == 2
    assert (event.target_rollouts, event.target_transitions) == (0, 0)
    assert {stage.kind for stage in stages.executed} == {"train_policy", "evaluate"}


def test_boxes_depend_on_the_seed_and_not_on_how_many_are_asked_for():
    few, many = (boxes_of(smoke("udr"), UdrSettings(policies=n)) for n in (2, 5))
    other = boxes_of(smoke("udr", seed=1), UdrSettings(policies=2))
    assert [box.to_json() for box in few] == [box.to_json() for box in many[:2]]
    assert not np.allclose(few[0].low, other[0].low)
