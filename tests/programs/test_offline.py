import pytest

from adr_service.distributions import Gaussian
from adr_service.stages.base import compute
from adr_service.stages.local import LocalStages
from adr_service.tasks.catalogue import source_of
from adr_service.transitions import TransitionDataset
from tests.programs.smoke import executed, iterations, smoke


def test_offline_methods_learn_from_simopts_trajectories():
    stages = LocalStages()
    iterations(smoke("simopt", iterations=2), stages)
    before = len(executed(stages, "target_rollout"))
    events = iterations(smoke("dropo", iterations=2), stages)
    assert [event.target_transitions for event in events] == [0, 20, 40]
    assert len(executed(stages, "target_rollout")) == before == 2


def test_an_offline_run_alone_runs_simopt_for_its_data():
    stages = LocalStages()
    events = iterations(smoke("sysid", iterations=3), stages)
    inferring = [stage.method.name for stage in executed(stages, "infer")]
    assert inferring.count("simopt") == 2  # the first trajectory is of the prior's policy
    assert inferring.count("sysid") == 3
    assert [event.target_rollouts for event in events] == [0, 1, 2, 3]


@pytest.mark.parametrize("start", ["scratch", "previous"])
@pytest.mark.parametrize(("collector", "policies"), [("prior", 1), ("random", 0)])
def test_other_collectors_need_no_inference(collector, policies, start):
    stages = LocalStages()
    spec = smoke("droid", collector=collector, iterations=2, training={"start": start})
    iterations(spec, stages)
    rollouts = executed(stages, "target_rollout")
    assert len({stage.policy for stage in rollouts} - {None}) == policies
    assert {stage.method.name for stage in executed(stages, "infer")} == {"droid"}


@pytest.mark.slow
def test_matched_random_actions_record_as_many_transitions_as_a_policy_that_stays_on_its_feet():
    found = {}
    for collector in ("random", "random_matched"):
        stages = LocalStages()
        spec = smoke("sysid", task="hopper", collector=collector, transitions=50, iterations=2)
        last = iterations(spec, stages)[-1]
        recorded = [stage.read(compute(stage)) for stage in executed(stages, "target_rollout")]
        assert last.target_transitions == sum(each.transitions for each in recorded)
        assert last.target_rollouts == len(recorded)
        data = TransitionDataset.from_npz(executed(stages, "infer")[-1].data)
        assert (len(data), data.episode_count) == (last.target_transitions, len(recorded))
        found[collector] = last
    assert found["random"].target_transitions < found["random_matched"].target_transitions == 100
    assert found["random"].target_rollouts == 2 < found["random_matched"].target_rollouts


def test_the_first_report_is_of_the_priors_policy():
    event = iterations(smoke("droid"), LocalStages())[0]
    prior = Gaussian.prior(source_of("arm", "vanilla").space)
    assert event.distributions == [prior.to_json()]
    assert (event.iteration, event.target_transitions, event.inferences) == (0, 0, [])
