import numpy as np

from adr_service.stages.base import compute
from adr_service.stages.local import LocalStages
from tests.programs.smoke import executed, iterations, smoke


def test_bayrn_starts_from_udrs_policies_and_trains_one_more_per_iteration():
    stages = LocalStages()
    iterations(smoke("udr"), stages)
    trained = {stage.digest for stage in executed(stages, "train_policy")}
    first, last = iterations(smoke("bayrn"), stages)
    new = {stage.digest for stage in executed(stages, "train_policy")} - trained
    assert len(new) == 1
    assert (first.target_rollouts, last.target_rollouts) == (2, 3)


def test_a_new_policy_starts_from_the_networks_of_the_last_where_that_is_asked_for():
    stages = LocalStages()
    iterations(smoke("bayrn", training={"start": "previous"}), stages)
    *initial, new = executed(stages, "train_policy")
    assert [stage.start for stage in initial] == [None, None]
    assert new.start == initial[-1].read(compute(initial[-1])).networks


def test_bayrn_sees_returns_and_no_transitions():
    stages = LocalStages()
    _, last = iterations(smoke("bayrn"), stages)
    for stage in executed(stages, "propose"):
        assert not stage.blobs
        assert len(stage.returns) == len(stage.distributions)
    assert len(last.diagnostics["returns_seen"]) == 3


def test_bayrn_reports_the_policy_that_it_believes_best():
    first, last = iterations(smoke("bayrn"), LocalStages())
    means = last.diagnostics["posterior_means"]
    assert last.diagnostics["reported"] == int(np.argmax(means))
    if last.diagnostics["reported"] < 2:
        assert last.policies[0] == first.policies[last.diagnostics["reported"]]
