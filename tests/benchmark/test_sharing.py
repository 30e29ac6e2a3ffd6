"""Work that runs of a benchmark share."""

import numpy as np

from adr_service.distributions import Gaussian
from adr_service.programs import run
from adr_service.programs.steps import training
from adr_service.specs import RunSpec
from adr_service.tasks.catalogue import source_of
from tests.benchmark.conftest import ITERATIONS
from tests.contracts.canned import CannedStages

VARIANTS = ("vanilla", "noisy", "unmodeled")


def test_the_prior_policy_of_a_seed_is_trained_once_for_all_methods(benchmark):
    spec, stages, _ = benchmark
    trainings = [s for s in stages.executed if s.kind == "train_policy"]
    assert len({s.digest for s in trainings}) == len(trainings)
    beliefs = [s.distribution.to_json() for s in trainings]
    priors = [b for b in beliefs if b["kind"] == "gaussian" and set(b["location"]) == {2.0}]
    assert spec.variants == ["vanilla", "noisy"]  # which have one source
    assert len(priors) == len(spec.seeds)


def test_offline_methods_add_no_rollout_of_a_policy(benchmark):
    """SimOpt's trajectories are there, and the prior's are SimOpt-1's."""
    spec, stages, _ = benchmark
    rollouts = [s for s in stages.executed if s.kind == "target_rollout"]
    runs = len(spec.seeds) * len(spec.variants)
    random = [s for s in rollouts if s.policy is None]
    assert len(random) == ITERATIONS * runs
    assert len(rollouts) - len(random) == (2 * ITERATIONS - 1) * runs  # the first is common to both


def test_variants_with_one_source_share_trainings_and_boxes():
    """Noise is the target's alone, so `noisy` and `vanilla` differ by it and by nothing else."""
    trainings = {variant: trainings_of("udr", variant) for variant in VARIANTS}
    assert trainings["noisy"] == trainings["vanilla"]
    assert not set(trainings["unmodeled"]) & set(trainings["vanilla"])
    assert trainings_of("prior", "noisy") == trainings_of("prior", "vanilla")


def test_an_extension_of_the_source_is_no_other_variants_source():
    effect = {"kind": "joint_coulomb_friction", "location": "joint:elbow", "values": [0.5]}
    extended = trainings_of("prior", "noisy", extension=[effect])
    assert extended == trainings_of("prior", "vanilla", extension=[effect])
    assert extended != trainings_of("prior", "noisy")


def trainings_of(method, variant, **more):
    """Digests of the trainings of a run."""
    given = {"task": "arm", "variant": variant, "method": method, "preset": "smoke"}
    stages = CannedStages()
    list(run(RunSpec.model_validate({**given, **more}), stages))
    return [digest for kind, digest in stages.asked if kind == "train_policy"]


def test_answers_that_are_one_point_at_the_resolution_share_a_policy():
    space = source_of("arm", "vanilla").space
    near = [Gaussian(space, np.full(4, 1.5 + moved), 1e-6 * np.eye(4)) for moved in (0, 1e-3)]
    given = {"task": "arm", "method": "dropo", "preset": "smoke"}
    fine = RunSpec.model_validate(given)
    coarse = RunSpec.model_validate({**given, "resolution": 0.01})
    one, other = (training(coarse, belief).digest for belief in near)
    assert one == other
    one, other = (training(fine, belief).digest for belief in near)
    assert one != other
    prior = Gaussian.prior(space)
    assert training(coarse, prior).digest == training(fine, prior).digest
