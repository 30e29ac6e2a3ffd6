from adr_service.stages.base import compute
from adr_service.stages.local import LocalStages
from tests.programs.smoke import executed, iterations, smoke


def test_a_run_trains_visits_and_infers_in_turn():
    stages = LocalStages()
    events = iterations(smoke("simopt", iterations=2), stages)
    kinds = [stage.kind for stage in stages.executed]
    one_round = ["train_policy", "evaluate", "target_rollout", "infer"]
    assert kinds == [*one_round, *one_round, "train_policy", "evaluate"]
    assert [event.iteration for event in events] == [0, 1, 2]


def test_each_inference_goes_on_from_the_state_of_the_one_before():
    stages = LocalStages()
    iterations(smoke("simopt", iterations=2), stages)
    first, second = executed(stages, "infer")
    assert second.state == first.read(compute(first)).state


def test_a_policy_starts_from_the_networks_of_the_one_before_where_that_is_asked_for():
    stages = LocalStages()
    training = {"start": "previous"}
    iterations(smoke("simopt", iterations=2, training=training), stages)
    first, second, third = executed(stages, "train_policy")
    assert first.start is None
    assert second.start == first.read(compute(first)).networks
    assert third.start == second.read(compute(second)).networks
    assert third.start != second.start


def test_policies_start_from_scratch_by_default():
    stages = LocalStages()
    iterations(smoke("simopt", iterations=1), stages)
    assert [stage.start for stage in executed(stages, "train_policy")] == [None, None]


def test_the_policy_of_a_visit_is_the_one_that_was_just_trained():
    stages = LocalStages()
    events = iterations(smoke("simopt", iterations=2), stages)
    hashes = [stage.document["blobs"]["policy"] for stage in executed(stages, "target_rollout")]
    assert hashes == [event.policies[0] for event in events[:2]]
