"""Policies as models of Stable-Baselines3, in folders that the Zoo reads."""

from dataclasses import replace

import numpy as np
import pytest
import yaml
from stable_baselines3 import PPO, SAC

from adr_service.errors import InvalidInput
from adr_service.interchange.rl_zoo import as_sb3, write_zoo_folder

IN_SB3 = pytest.mark.parametrize("squash", ["tanh", "clip"], indirect=True)
CURVE = [{"steps": 1000, "mean_return": 1.5}, {"steps": 2000, "mean_return": 2.5}]


@pytest.mark.parametrize("squash", ["bins"], indirect=True)
def test_a_policy_of_bins_is_refused(policy, task, tmp_path):
    with pytest.raises(InvalidInput, match="no counterpart"):
        write_zoo_folder(tmp_path, policy, task.name, "vanilla", CURVE)


@IN_SB3
def test_the_model_predicts_what_the_policy_does(policy, task, squash, observations, tmp_path):
    folder = write_zoo_folder(tmp_path, policy, task.name, "noisy", CURVE)
    model = {"tanh": SAC, "clip": PPO}[squash].load(folder / "best_model.zip", buffer_size=1)
    actions, _ = model.predict(observations, deterministic=True)
    width = task.action_high - task.action_low
    assert np.max(np.abs(actions - policy.act(observations)) / width) < 1e-6


@IN_SB3
def test_the_zoo_finds_environment_and_evaluations(policy, task, tmp_path):
    first, second = (write_zoo_folder(tmp_path, policy, task.name, "noisy", CURVE) for _ in "ab")
    assert (first.name[-2:], second.name[-2:]) == ("_1", "_2")
    (args,) = first.glob("*/args.yml")
    about = yaml.safe_load(args.read_text())
    assert about["env"].startswith("adr/Random")
    assert about["env_kwargs"] is None  # `enjoy` reads it
    assert about["env"].replace("/", "-") == args.parent.name == first.name[:-2]
    assert first.parent.name == about["algo"]
    evaluations = np.load(first / "evaluations.npz")
    assert evaluations["timesteps"].tolist() == [1000, 2000]
    assert evaluations["results"].mean(axis=1).tolist() == [1.5, 2.5]


@pytest.mark.parametrize("squash", ["clip"], indirect=True)
def test_actions_lie_about_the_middle_of_uneven_bounds(policy, task, observations):
    uneven = replace(policy, action_low=policy.action_low / 2)
    actions, _ = as_sb3(uneven, task.name, "vanilla").predict(observations, deterministic=True)
    within = np.clip(actions, uneven.action_low, uneven.action_high)
    np.testing.assert_allclose(within, uneven.act(observations), atol=1e-6)
