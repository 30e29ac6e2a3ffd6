"""Evaluations on the simulated target."""

from dataclasses import replace

import numpy as np
import pytest

from adr_service.errors import InvalidInput
from adr_service.stages.base import compute
from adr_service.stages.evaluate import Evaluate
from adr_service.tasks.catalogue import get_task
from tests.packages import python
from tests.planted import still_policy, waving_policy
from tests.stages.examples import UNSTABLE, Speed

STAGE = Evaluate(
    task="arm", variant="vanilla", episodes=6, seed=0, policy=waving_policy().to_bytes()
)
PRINT_RETURNS = """
from adr_service.stages.base import compute
from tests.stages.test_evaluate import STAGE
print([value.hex() for value in compute(STAGE).values["returns"]])
"""


def test_there_is_one_return_per_episode_and_no_two_are_equal():
    result = STAGE.read(compute(STAGE))
    assert len(set(result.returns)) == STAGE.episodes
    assert result.diverged_episodes == 0


@pytest.mark.parametrize("threads", [1, 2])
def test_returns_do_not_depend_on_the_machines_number_of_threads(threads, monkeypatch):
    for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
        monkeypatch.setenv(name, str(threads))
    printed = python(PRINT_RETURNS)
    assert printed.returncode == 0, printed.stderr
    here = [float(value).hex() for value in compute(STAGE).values["returns"]]
    assert printed.stdout.strip() == str(here)


def test_diverged_episodes_are_counted_and_have_a_finite_return():
    policy = still_policy(get_task("half_cheetah")).to_bytes()
    stage = replace(STAGE, **UNSTABLE, policy=policy)
    result = stage.read(compute(stage))
    assert result.diverged_episodes == stage.episodes
    assert np.all(np.isfinite(result.returns))


def test_the_noisy_target_earns_another_return():
    """The policy acts on what it measures."""
    noisy = replace(STAGE, variant="noisy")
    assert compute(noisy).values["returns"] != compute(STAGE).values["returns"]


def test_bytes_that_are_no_policy_are_refused():
    with pytest.raises(InvalidInput, match="not the bytes of a policy"):
        compute(replace(STAGE, policy=b"weights"))


def test_its_cost_is_proportional_to_the_episodes_and_not_metered():
    cost = STAGE.cost(Speed(100.0))
    assert cost.seconds == 6 * get_task("arm").horizon / 100
    assert cost.target_transitions == 0
    assert STAGE.stand_in().returns == [0.0] * 6
