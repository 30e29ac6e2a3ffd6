import pytest
from pydantic import ValidationError

from adr_service.methods.simopt import SimOptSettings
from adr_service.presets import PRESETS
from adr_service.specs import BenchmarkSpec, ExternalTarget, RunSpec

GOOD = {"task": "arm", "method": "simopt", "preset": "smoke"}


@pytest.mark.parametrize("preset", PRESETS)
@pytest.mark.parametrize("method", ["udr", "simopt", "dropo", "prior", "oracle"])
def test_every_preset_completes_a_spec_that_survives_json(preset, method):
    spec = RunSpec.model_validate({"task": "hopper", "method": method, "preset": preset})
    assert RunSpec.model_validate_json(spec.model_dump_json()) == spec


def test_the_paper_preset_is_the_papers_protocol():
    """Tiboni et al., Sec. 3.2 and 3.4."""
    spec = RunSpec.model_validate({"task": "hopper", "method": "simopt", "preset": "paper"})
    assert (spec.iterations, spec.transitions, spec.evaluation_episodes) == (5, 200, 100)
    assert (spec.method.updates, spec.method.samples) == (5, 1000)
    training = spec.training
    assert (training.max_steps, training.environments) == (5_000_000, 12)
    assert (training.hidden, training.activation, training.gradient_steps) == (
        [128, 128],
        "tanh",
        1,
    )
    dropo = RunSpec.model_validate({"task": "hopper", "method": "dropo", "preset": "paper"})
    assert dropo.method.samples_per_parameter == 10
    udr = RunSpec.model_validate({"task": "hopper", "method": "udr", "preset": "paper"})
    assert udr.method.policies == 10


def test_what_is_given_wins_over_the_preset_field_by_field():
    spec = RunSpec.model_validate(
        {**GOOD, "method": {"name": "simopt", "samples": 17}, "training": {"max_steps": 500}}
    )
    assert (spec.method.samples, spec.method.updates) == (17, 2)
    assert (spec.training.max_steps, spec.training.batch_size) == (500, 32)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (
            {"task": "humanoid", "method": "dropo_smoothed"},
            "method: dropo_smoothed cannot smooth the states of humanoid: the model has 24",
        ),
        (
            {"task": "humanoid", "method": {"name": "simopt", "samples": 30}},
            "method: 30 samples of 30 parameters have no spread in some direction",
        ),
        (
            {"task": "humanoid", "method": "dropo", "simopt": {"samples": 30}},
            "simopt: 30 samples of 30 parameters have no spread in some direction",
        ),
        (
            {"task": "hoper"},
            "there is no task 'hoper'; did you mean 'hopper'? accepted: arm, hopper",
        ),
        ({"method": "simop"}, "did you mean 'simopt'? accepted: auto_dr, doraemon, epopt"),
        ({"variant": "windy"}, "accepted: vanilla, noisy, unmodeled"),
        ({"preset": "huge"}, "accepted: smoke, demo, quick, fast, paper"),
        ({"iterations": -1}, "greater than or equal to 1"),
        ({"seed": 1.5}, "valid integer"),
        ({"seed": "1"}, "valid integer"),
        ({"seed": True}, "valid integer"),
        ({"sed": 1}, "there is no field 'sed'; did you mean 'seed'?"),
        ({"training": {"max_step": 1}}, "did you mean 'max_steps'?"),
        ({"training": {"gamma": float("nan")}}, "finite number"),
        ({"training": {"learning_rate": float("inf")}}, "finite number"),
        ({"method": {"name": "simopt", "budget": 3}}, "there is no field 'budget'"),
        (
            {"method": 3},
            "give a method's name, or its settings with `name`; accepted: auto_dr, doraemon, epopt",
        ),
        ({"method": {"updates": 3}}, "or its settings with `name`"),
        ({"method": "dropo", "simopt": "simop"}, "should be 'simopt'"),
        ({"method": "drop", "simopt": "simopt"}, "did you mean 'dropo'?"),
        (
            {"collector": "x"},
            "should be 'simopt', 'prior', 'random', 'random_matched' or 'recording'",
        ),
        ({"preset": 3}, "valid string"),
        ({"training": 3}, "give training settings whose algorithm is"),
        ({"training": {"hidden": [0]}}, "greater than or equal to 1"),
        ({"transitions": 201}, "arm has 200 steps at most: give that many or fewer"),
        (
            {"transitions": 20, "method": {"name": "sysid", "steps": 21}},
            "20 given, and sysid with steps = 21 learns from no fewer",
        ),
        ({"task": None}, "valid string"),
    ],
    ids=str,
)
def test_a_mistake_is_one_error_at_its_field_with_what_is_accepted(change, message):
    with pytest.raises(ValidationError) as refused:
        RunSpec.model_validate({**GOOD, **change})
    (error,) = refused.value.errors()
    assert message in error["msg"]
    place = error["loc"] or [error["msg"].removeprefix("Value error, ").partition(":")[0]]
    assert place[0] in change or "'sed'" in error["msg"]


def test_only_methods_that_use_rollouts_need_them_within_the_horizon():
    """A preset's 200 transitions may be more than an episode of a task has."""
    for method in ("udr", "bayrn", "doraemon"):
        RunSpec.model_validate({**GOOD, "method": method, "transitions": 201})


def test_values_of_ours_are_as_good_as_their_json():
    assert RunSpec.model_validate({**GOOD, "target": ExternalTarget()}).target == ExternalTarget()
    for named in (SimOptSettings(samples=40), SimOptSettings(name="simopt", samples=40)):
        spec = RunSpec.model_validate({**GOOD, "method": named})
        assert spec.method == SimOptSettings(updates=2, samples=40)  # the rest is the preset's
    grid = {"tasks": ["arm"], "methods": [SimOptSettings(samples=40)], "preset": "smoke"}
    assert BenchmarkSpec.model_validate({**grid, "references": False, "seeds": [0]}).size == 1


def test_a_method_that_visits_its_target_cannot_replay_from_smoothed_states(monkeypatch):
    """As a method of one's own may ask for; it was ignored, with the policy that made the data."""
    monkeypatch.setattr(SimOptSettings, "replay_from", "smoothed", raising=False)
    with pytest.raises(ValidationError, match="method: simopt replays from smoothed states"):
        RunSpec.model_validate(GOOD)
