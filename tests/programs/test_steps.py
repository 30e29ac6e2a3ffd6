import numpy as np

from adr_service.programs.steps import joined
from adr_service.stages.base import compute
from adr_service.stages.local import LocalStages
from adr_service.target import Visit
from adr_service.transitions import TransitionDataset
from tests.programs.smoke import executed, iterations, smoke
from tests.recordings import recording


def test_the_epsilon_that_predicts_best_is_taken():
    stages = LocalStages()
    tried = {"name": "dropo", "epsilon": [1e-6, 1e-4, 1e-2]}
    final = iterations(smoke(tried), stages)[-1]
    errors = final.diagnostics["mean_squared_error_by_epsilon"]
    assert set(errors) == {"1e-06", "0.0001", "0.01"}
    (chosen,) = (
        stage
        for stage in executed(stages, "infer")
        if stage.method.name == "dropo" and stage.method.epsilon == final.diagnostics["epsilon"]
    )
    answer = chosen.read(compute(chosen))
    assert final.distributions == [answer.distribution.to_json()]
    assert answer.diagnostics["mean_squared_error"] <= 1.01 * min(errors.values())
    assert len(executed(stages, "infer")) == len(final.inferences) == 3
    assert len(executed(stages, "train_policy")) == 2


def test_the_cost_of_a_grid_is_the_sum_of_its_searches():
    stages = LocalStages()
    tried = {"name": "dropo", "epsilon": [1e-5, 1e-3]}
    both = iterations(smoke(tried), stages)[-1].inference_steps
    alone = [
        iterations(smoke({**tried, "epsilon": epsilon}), stages)[-1].inference_steps
        for epsilon in tried["epsilon"]
    ]
    assert both == sum(alone)


def test_a_method_on_smoothed_states_learns_from_what_their_stage_gives():
    stages = LocalStages()
    final = iterations(smoke("sysid_smoothed", variant="noisy"), stages)[-1]
    (smoothing,), (inferring,) = executed(stages, "smooth_states"), executed(stages, "infer")
    smoothed = smoothing.read(compute(smoothing))
    assert inferring.data == smoothed.data != smoothing.data
    assert final.inferences == [smoothing.digest, inferring.digest]
    assert final.diagnostics["smoothing"]["sensor_std"] == smoothed.sensor_std
    alone = inferring.read(compute(inferring))
    assert final.inference_steps == smoothed.simulated_steps + alone.simulated_steps


def test_methods_on_smoothed_states_share_the_smoothing():
    stages = LocalStages()
    for method in ("sysid_smoothed", "droid_smoothed"):
        iterations(smoke(method), stages)
    assert len(executed(stages, "smooth_states")) == 1


def test_visits_are_joined_in_order_one_episode_each():
    parts = [recording("arm", n) for n in (5, 7)]
    whole = TransitionDataset.from_npz(joined([Visit(None, part) for part in parts]))
    assert whole.episode_count == 2
    np.testing.assert_array_equal(whole.actions, np.concatenate([p.actions for p in parts]))


def test_a_report_counts_what_the_target_showed():
    events = iterations(smoke("simopt", iterations=2), LocalStages())
    assert [event.target_transitions for event in events] == [0, 20, 40]
    assert [event.evaluation_episodes for event in events] == [4, 4, 4]
    assert all(len(event.returns[0]) == 4 for event in events)
