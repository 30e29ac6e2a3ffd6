"""Settings of trainings: their defaults, bounds and JSON."""

import pytest
from pydantic import TypeAdapter, ValidationError

from adr_service.errors import InvalidInput
from adr_service.training.settings import (
    CrossQSettings,
    PpoSettings,
    SacSettings,
    TrainingSettings,
    check_backend,
)
from tests.training.examples import settings

ANY = TypeAdapter(TrainingSettings)


@pytest.mark.parametrize(("found", "backend"), [(None, "sb3"), (object(), "sbx")])
def test_the_default_backend_is_sbx_where_it_is_installed(monkeypatch, found, backend):
    monkeypatch.setattr("adr_service.training.settings.find_spec", lambda name: found)
    assert ANY.validate_python({}).backend == backend
    if found is None:
        with pytest.raises(InvalidInput, match=r"adr-service\[fast\]"):
            check_backend("sbx")
    else:
        check_backend("sbx")


def test_defaults_are_those_of_the_paper():
    given = ANY.validate_python({})
    assert isinstance(given, SacSettings)
    assert (given.max_steps, given.environments) == (5_000_000, 12)
    assert given.hidden == [128, 128]


@pytest.mark.parametrize(
    ("algorithm", "kind"), [("sac", SacSettings), ("crossq", CrossQSettings), ("ppo", PpoSettings)]
)
def test_json_gives_the_same_settings_back(algorithm, kind):
    given = settings(algorithm, backend="sb3", learning_rate=3e-4, hidden=[16])
    assert isinstance(given, kind)
    assert ANY.validate_json(ANY.dump_json(given)) == given


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"max_steps": 10}, "greater than or equal to 100"),
        ({"gamma": 1.0}, "less than 1"),
        ({"tau": 0.0}, "greater than 0"),
        ({"hidden": []}, "at least 1 item"),
        ({"hidden": [0]}, "greater than or equal to 1"),
        ({"backend": "ppo"}, "'sbx' or 'sb3'"),
        ({"learning_rate": float("nan")}, "finite|greater than 0"),
        ({"batchsize": 32}, "did you mean 'batch_size'"),
        ({"algorithm": "td3"}, "algorithm is 'sac' .the default., 'crossq' or 'ppo'"),
        ({"algorithm": "ppo", "tau": 0.005}, "there is no field 'tau'"),
        ({"algorithm": "crossq", "epochs": 5}, "there is no field 'epochs'"),
        ({"epochs": 5}, "there is no field 'epochs'"),
        ({"algorithm": "ppo", "batch_size": 500}, "500 given, which does not divide the 4096"),
        (
            {"algorithm": "ppo", "action_bins": 5, "log_deviation": -1},
            "action_bins: 5 given",
        ),
        # one rollout, whose update no evaluation would see
        (
            {"algorithm": "ppo", "max_steps": 8191},
            "8191 given, fewer than the 8192 .* two rollouts",
        ),
        ({"max_steps": 100, "environments": 101}, "100 given, fewer than the 101 environments"),
        ({"max_steps": 600, "learning_starts": 600}, "600 given, not fewer than the 600 of max_st"),
        ({"algorithm": "crossq", "batch_size": 1}, "greater than or equal to 2"),
        ({"learning_rate": 1e300}, "less than or equal to 1000"),
        ({"algorithm": "crossq", "learning_rate": 1e300}, "less than or equal to 1000"),
        ({"algorithm": "ppo", "learning_rate": 1e300}, "less than or equal to 1000"),
    ],
)
def test_a_value_out_of_bounds_is_refused_with_the_bound(given, message):
    with pytest.raises(ValidationError, match=message):
        ANY.validate_python(given)


def test_only_sac_reports_its_best_evaluation_as_it_is():
    assert settings("sac").confirmation is None
    assert {settings(name).confirmation for name in ("crossq", "ppo")} == {6}


@pytest.mark.parametrize(
    ("max_steps", "expected"), [(600, 300), (1000, 500), (1001, 1000), (5_000_000, 1000)]
)
def test_random_actions_are_by_default_half_of_a_short_training_at_most(max_steps, expected):
    given = ANY.validate_python({"algorithm": "crossq", "max_steps": max_steps})
    assert given.learning_starts == expected
    assert ANY.validate_json(ANY.dump_json(given)) == given


def test_two_rollouts_of_ppo_are_enough():
    assert ANY.validate_python({"algorithm": "ppo", "max_steps": 8192}).steps == 8192


def test_ppo_uses_whole_rollouts():
    given = settings("ppo", max_steps=300, environments=12, rollout_steps=8)
    assert given.steps == 288
    assert settings("crossq", max_steps=300).steps == 300


def test_a_digest_leaves_out_new_settings_that_change_nothing():
    """Results outlive refactoring."""
    assert not {"algorithm", "start", "averaged_steps"} & settings("sac").to_json().keys()
    assert settings("sac").model_dump()["algorithm"] == "sac"
    assert not {"action_bins", "learning_rate_schedule"} & settings("ppo").to_json().keys()
    given = settings("ppo", start="previous").to_json()
    assert (given["algorithm"], given["start"]) == ("ppo", "previous")
