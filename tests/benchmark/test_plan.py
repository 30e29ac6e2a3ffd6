"""A plan is the programs themselves, over stages that price."""

import numpy as np
import pytest

from adr_service.benchmark.plan import plan
from adr_service.errors import InvalidInput
from adr_service.methods.simopt import SimOpt
from adr_service.simulation.batch import control_period
from adr_service.specs import BenchmarkSpec, CriticismSpec, RunSpec
from adr_service.tasks.catalogue import get_task
from adr_service.transitions import dataset_id
from tests.programs.smoke import smoke
from tests.recordings import recording
from tests.stages.examples import Speed


def test_the_plan_counts_the_stages_that_happen(benchmark):
    spec, stages, _ = benchmark
    planned = plan(list(spec.runs()), cores=2)
    executed = {kind: [s for s in stages.executed if s.kind == kind] for kind in KINDS}
    trained = [stage for stage in executed["train_policy"] if stage.repeat is None]
    # BayRn trains once more in every iteration, unless it chooses a box again
    again = sum(run.iterations for run in spec.runs() if run.method.name == "bayrn")
    assert planned.trainings == len(trained) + again >= len(executed["train_policy"])
    most = sum(stage.transitions for stage in executed["target_rollout"])
    most += len(executed["target_return"]) * get_task("arm").horizon
    assert planned.target_transitions == most
    (each,) = {stage.training.max_steps for stage in trained}
    assert planned.environment_steps == planned.trainings * each


KINDS = ("train_policy", "target_rollout", "target_return")


def test_more_cores_take_less_time_and_the_same_core_hours():
    runs = list(BenchmarkSpec.model_validate(GRID).runs())
    one, two, many = (plan(runs, cores, speed=Speed()) for cores in (1, 2, 1000))
    assert one.hours == pytest.approx(one.core_hours, rel=1e-9)  # one core is never idle
    assert one.hours > two.hours > many.hours > 0
    assert one.trainings == two.trainings == many.trainings


GRID = {"tasks": ["arm"], "methods": ["udr", "simopt"], "seeds": [0, 1], "preset": "demo"}


def test_one_after_the_other_is_no_faster_on_many_cores():
    """SimOpt's trainings wait for each other; UDR's three run side by side."""
    simopt, udr = (
        RunSpec.model_validate({"task": "arm", "method": method, "preset": "demo"})
        for method in ("simopt", "udr")
    )
    assert hours(simopt, 8) > 0.9 * hours(simopt, 1)
    assert hours(udr, 3) < 0.4 * hours(udr, 1)


def hours(spec, cores):
    return plan([spec], cores, speed=Speed()).hours


def test_one_robot_runs_one_episode_after_the_other():
    spec = smoke("simopt", target={"kind": "external"}, evaluation_episodes=10)
    episodes = 2 * 10 * 200 + 20  # evaluated twice, and visited once
    assert hours(spec, 100) > episodes * control_period(get_task("arm")) / 3600


def test_a_stage_is_priced_once_however_long_a_run_is():
    """A plan's stages grow in proportion to the iterations, and so does its cost."""
    few, many = (plan([smoke("dropo", iterations=n)], 1, speed=Speed()).trainings for n in (5, 50))
    assert (few, many) == (1 + 4 + 5, 1 + 49 + 50)  # the prior, SimOpt's, and DROPO's


def test_without_cores_there_is_no_time():
    assert plan([smoke("prior")], 0).hours is None


def test_equal_runs_are_paid_for_once():
    alone, twice = plan([smoke("dropo")], 1), plan([smoke("dropo"), smoke("dropo")], 1)
    assert twice.trainings == alone.trainings
    assert (alone.runs, twice.runs) == (1, 2)
    assert plan([smoke("dropo"), smoke("dropo", seed=1)], 1).trainings == 2 * alone.trainings


def test_a_robots_episodes_take_time_and_no_core():
    spec = smoke("simopt", target={"kind": "external"})
    planned, simulated = plan([spec], 2), plan([smoke("simopt")], 2)
    assert planned.hours > simulated.hours
    assert planned.core_hours < planned.hours
    assert planned.target_transitions == simulated.target_transitions


def test_a_recording_is_priced_by_its_length():
    content = recording("arm", 30).to_npz()
    target = {"kind": "recorded", "dataset": dataset_id(content)}
    planned = plan([smoke("sysid", target=target)], 2, lambda spec: content)
    assert (planned.trainings, planned.target_transitions) == (1, 0)


@pytest.mark.parametrize(
    "broken", [{"start": np.zeros(3)}, ZeroDivisionError("as methods do"), SystemExit(1)]
)
def test_a_method_that_breaks_is_named_before_its_run_is_submitted(broken, monkeypatch):
    """It was answered as a defect of the service."""

    def start(self, problem):
        if isinstance(broken, BaseException):
            raise broken
        return broken

    monkeypatch.setattr(SimOpt, "start", start)
    spec = RunSpec.model_validate({"task": "arm", "method": "simopt", "preset": "smoke"})
    with pytest.raises(InvalidInput, match="a run of simopt cannot be planned: its program raises"):
        plan([spec], cores=1)


def test_a_criticism_has_a_price():
    spec = CriticismSpec.model_validate({"task": "arm", "dataset": "data_0"})
    assert plan([spec], 1, lambda spec: b"measured").core_hours > 0


def test_policies_are_as_large_as_their_weights():
    planned = plan([smoke("prior")], 1)
    weights = (4 + 1) * 16 + (16 + 1) * 16 + (16 + 1) * 2
    assert planned.policies_mb == pytest.approx(4 * weights / 1e6)
