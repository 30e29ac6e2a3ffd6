from adr_service.stages.local import LocalStages
from tests.programs.smoke import executed, iterations, smoke


def test_simopt_1_learns_from_the_priors_policy_alone():
    stages = LocalStages()
    final = iterations(smoke("simopt_1", iterations=2), stages)[-1]
    rollouts = executed(stages, "target_rollout")
    assert len({stage.policy for stage in rollouts}) == 1
    assert final.target_rollouts == len(rollouts) == 2


def test_every_inference_starts_from_the_prior_with_all_data():
    stages = LocalStages()
    iterations(smoke("simopt_1", iterations=2), stages)
    first, second = executed(stages, "infer")
    assert first.state == second.state
    assert len(second.data) > len(first.data)
