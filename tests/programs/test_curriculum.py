import pytest

from adr_service.distributions import Uniform
from adr_service.stages.local import LocalStages
from tests.planted import SPACE
from tests.programs.smoke import executed, iterations, smoke

PPO = {
    "algorithm": "ppo",
    "environments": 12,
    "rollout_steps": 8,
    "batch_size": 32,
    "epochs": 2,
    "max_steps": 4800,
    "evaluate_every": 2400,
}


@pytest.mark.parametrize("name", ["fixed_dr", "auto_dr", "doraemon", "epopt"])
def test_a_curriculum_trains_one_policy_and_visits_the_target_for_evaluation_alone(name):
    stages = LocalStages()
    spec = smoke({"name": name, "episodes": 12}, training=PPO)
    (event,) = iterations(spec, stages)
    (training,) = executed(stages, "train_policy")
    assert len(event.policies) == 1
    assert (event.target_rollouts, event.target_transitions) == (0, 0)
    assert training.distribution.to_json() == Uniform(SPACE, SPACE.low, SPACE.high).to_json()
    assert training.inputs["curriculum"]["name"] == name
