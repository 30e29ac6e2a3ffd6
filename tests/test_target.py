import pytest

from adr_service.errors import BudgetExceeded
from adr_service.stages.local import drained
from adr_service.target import Target, open_target
from tests.contracts.canned import CannedStages
from tests.programs.smoke import smoke


def test_a_target_counts_and_refuses_a_rollout_over_the_budget():
    target, stages = opened(smoke("simopt"))
    drained(target.rollout(None, 0))
    assert (target.rollouts, target.transitions) == (1, 20)
    with pytest.raises(BudgetExceeded, match="1 used and 1 more asked for, but the budget is 1"):
        drained(target.rollout(None, 1))
    assert len(stages.asked) == 1


def test_returns_are_metered_beyond_the_budget_and_evaluations_are_not():
    target, _ = opened(smoke("bayrn"))
    returns = drained(target.returns([b"one", b"two"], 0))
    assert len(returns) == target.rollouts == 2
    assert target.transitions == 400
    evaluations = drained(target.evaluate([b"one"]))
    assert len(evaluations[0].returns) == 4
    assert (target.rollouts, target.transitions) == (2, 400)


def test_a_robots_episodes_belong_to_its_run_and_evaluations_are_single_episodes():
    target, stages = opened(smoke("simopt", target={"kind": "external"}))
    drained(target.rollout(b"policy", 0))
    evaluations = drained(target.evaluate([b"one", b"two"]))
    assert [len(evaluation.returns) for evaluation in evaluations] == [5, 5]
    assert evaluations[0] != evaluations[1]
    alone = [drained(target.evaluate([policy]))[0] for policy in (b"one", b"two")]
    assert evaluations == alone
    assert {kind for kind, _ in stages.asked} == {"target_episode"}
    assert len(stages.asked) == 1 + 2 * 10


def test_two_runs_share_simulated_visits_and_no_robots_visits():
    def digests(run_id, **changes):
        stages = CannedStages()
        stages.run_id = run_id
        drained(open_target(smoke("simopt", **changes), stages).rollout(b"policy", 0))
        return stages.asked

    assert digests("run_1") == digests("run_2")
    outside = {"target": {"kind": "external"}}
    assert digests("run_1", **outside) != digests("run_2", **outside)


def opened(spec) -> tuple[Target, CannedStages]:
    stages = CannedStages()
    return open_target(spec, stages), stages


def test_random_episodes_share_the_transitions_of_a_rollout_and_no_more():
    target, _ = opened(smoke("sysid", collector="random_matched"))
    visit = drained(target.random_episodes())
    assert len(visit.data) == target.transitions == 20
    with pytest.raises(BudgetExceeded, match="20 used and 20 more asked for, but the budget is 20"):
        drained(target.random_episodes())
