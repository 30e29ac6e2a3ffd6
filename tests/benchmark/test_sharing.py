"""Work that runs of a benchmark share."""

from tests.benchmark.conftest import ITERATIONS


def test_the_prior_policy_of_a_seed_is_trained_once_for_all_methods(benchmark):
    spec, stages, _ = benchmark
    trainings = [s for s in stages.executed if s.kind == "train_policy"]
    assert len({s.digest for s in trainings}) == len(trainings)
    beliefs = [s.distribution.to_json() for s in trainings]
    priors = [b for b in beliefs if b["kind"] == "gaussian" and set(b["location"]) == {2.0}]
    assert len(priors) == len(spec.seeds) * len(spec.variants)


def test_offline_methods_add_no_rollout_of_a_policy(benchmark):
    """SimOpt's trajectories are there, and the prior's are SimOpt-1's."""
    spec, stages, _ = benchmark
    rollouts = [s for s in stages.executed if s.kind == "target_rollout"]
    runs = len(spec.seeds) * len(spec.variants)
    random = [s for s in rollouts if s.policy is None]
    assert len(random) == ITERATIONS * runs
    assert len(rollouts) - len(random) == (2 * ITERATIONS - 1) * runs  # the first is common to both
