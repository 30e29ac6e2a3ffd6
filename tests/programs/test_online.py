from adr_service.stages.base import compute
from adr_service.stages.infer import unpacked
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


def test_simopt_with_a_memory_learns_from_all_visits_each_with_its_policy():
    stages = LocalStages()
    events = iterations(smoke("simopt_memory", iterations=3), stages)
    recorded = [stage.read(compute(stage)).data for stage in executed(stages, "target_rollout")]
    flown = [stage.policy for stage in executed(stages, "target_rollout")]
    for number, stage in enumerate(executed(stages, "infer")):
        earlier = [(policy, data.to_npz()) for policy, data in unpacked(stage.earlier)]
        assert earlier == list(zip(flown, recorded, strict=True))[:number]
        assert (stage.policy, stage.data) == (flown[number], recorded[number])
    steps = [event.inference_steps for event in events]
    assert steps == [0, steps[1], 2 * steps[1], 3 * steps[1]]


def test_simopt_itself_has_the_last_visit_alone():
    stages = LocalStages()
    iterations(smoke("simopt", iterations=2), stages)
    assert [stage.earlier for stage in executed(stages, "infer")] == [None, None]
