import numpy as np
import pytest
from pydantic import ValidationError

from adr_service.programs.references import truth_of, truth_training
from adr_service.stages.local import LocalStages
from tests.programs.smoke import executed, iterations, smoke

HIDDEN = [{"kind": "joint_coulomb_friction", "location": "joint:elbow", "values": [0.3]}]


def test_the_prior_and_the_oracle_are_trained_and_evaluated_once():
    for method in ("prior", "oracle"):
        stages = LocalStages()
        (event,) = iterations(smoke(method), stages)
        assert [stage.kind for stage in stages.executed] == ["train_policy", "evaluate"]
        assert event.target_rollouts == 0


def test_the_oracle_is_trained_on_the_truth_of_every_variant():
    digests = {truth_training(smoke("oracle", variant=v)).digest for v in ("vanilla", "unmodeled")}
    assert len(digests) == 1  # one truth behind both
    np.testing.assert_array_equal(truth_of("arm", "noisy").mean, [1.0, 0.7, 2.0, 1.0])


def test_the_oracle_knows_the_hidden_effects():
    target = {"kind": "simulated", "effects": HIDDEN}
    stages = LocalStages()
    iterations(smoke("oracle", target=target), stages)
    (training,) = executed(stages, "train_policy")
    assert "joint_coulomb_friction" in training.variant


def test_nobody_knows_a_robots_truth():
    with pytest.raises(ValidationError, match="nobody knows the truth that the oracle"):
        smoke("oracle", target={"kind": "external"})
