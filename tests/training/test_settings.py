"""Settings of a training: their defaults, bounds and JSON."""

import pytest
from pydantic import ValidationError

from adr_service.training.settings import TrainingSettings


def test_defaults_are_valid_and_choose_a_backend_that_is_installed():
    settings = TrainingSettings()
    assert settings.backend in {"sbx", "sb3"}
    assert (settings.max_steps, settings.environments) == (5_000_000, 12)
    assert settings.hidden == [128, 128]


def test_json_gives_the_same_settings_back():
    settings = TrainingSettings(backend="sb3", learning_rate=3e-4, hidden=[16])
    assert TrainingSettings.model_validate_json(settings.model_dump_json()) == settings


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
    ],
)
def test_a_value_out_of_bounds_is_refused_with_the_bound(given, message):
    with pytest.raises(ValidationError, match=message):
        TrainingSettings.model_validate(given)
