import numpy as np

from adr_service.json_values import sha256
from adr_service.stages.base import compute
from adr_service.stages.local import LocalStages
from tests.programs.smoke import executed, iterations, smoke

BEST = {"name": "bayrn", "report": "best"}


def test_bayrn_starts_from_udrs_policies_and_trains_one_more_per_iteration():
    stages = LocalStages()
    iterations(smoke("udr"), stages)
    trained = {stage.digest for stage in executed(stages, "train_policy")}
    first, last = iterations(smoke(BEST), stages)
    new = {stage.digest for stage in executed(stages, "train_policy")} - trained
    assert len(new) == 1
    assert (first.target_rollouts, last.target_rollouts) == (2, 3)


def test_a_new_policy_starts_from_the_networks_of_the_last_where_that_is_asked_for():
    stages = LocalStages()
    iterations(smoke(BEST, training={"start": "previous"}), stages)
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


def reported(last, stages):
    """The trainings of the box that is believed best, and the digest of the reported policy."""
    best = last.diagnostics["reported"]
    assert best == int(np.argmax(last.diagnostics["posterior_means"]))
    box = executed(stages, "propose")[-1].distributions[best]
    assert last.distributions == [box.to_json()]
    on_it = [
        s for s in executed(stages, "train_policy") if s.distribution.to_json() == box.to_json()
    ]
    return {s.repeat: sha256(s.read(compute(s)).policy) for s in on_it}, last.policies[0]


def test_bayrn_reports_one_more_policy_trained_on_the_box_that_it_believes_best():
    stages = LocalStages()
    _, last = iterations(smoke("bayrn"), stages)
    trained, policy = reported(last, stages)
    assert policy == trained[1] != trained[None]


def test_bayrn_may_report_the_policy_that_it_believes_best():
    stages = LocalStages()
    _, last = iterations(smoke(BEST), stages)
    trained, policy = reported(last, stages)
    assert trained == {None: policy}


def test_what_is_reported_changes_no_proposal():
    asked = []
    for method in ("bayrn", BEST):
        stages = LocalStages()
        iterations(smoke(method), stages)
        asked.append([stage.digest for stage in executed(stages, "propose")])
    assert asked[0] == asked[1]


def test_one_more_policy_starts_where_the_first_on_its_box_did():
    stages = LocalStages()
    _, last = iterations(smoke("bayrn", training={"start": "previous"}), stages)
    box = last.distributions[0]
    trained = executed(stages, "train_policy")
    first, again = (s for s in trained if s.distribution.to_json() == box)
    assert (first.repeat, again.repeat) == (None, 1)
    assert first.start == again.start
