"""System identification's answer, its standard deviations, and its refusals."""

from dataclasses import replace

import numpy as np
import pytest

from adr_service.distributions import Uniform
from adr_service.errors import InvalidInput
from adr_service.methods.sysid import Sysid, SysidSettings
from adr_service.progress import silent
from adr_service.randomness import stream
from tests.planted import PLANTED, PROBLEM, SPACE, recorded, waving_policy


def fit(data, **settings):
    return Sysid(SysidSettings(**settings)).fit(PROBLEM, data, stream("s"), silent)


def test_the_answer_is_one_point():
    estimate = fit(recorded(waving_policy(), steps=20), starts=1)
    assert isinstance(estimate.distribution, Uniform)
    assert np.all(estimate.distribution.std == 0)


def test_standard_deviations_are_those_of_repeated_recordings():
    """Root mean square over 12 recordings, which errs by a fifth; the noise is on outputs."""
    errors, reported = [], []
    for seed in range(12):
        clean = recorded(waving_policy(), seed=seed)
        noise = 0.003 * np.random.default_rng(seed).standard_normal((len(clean), 4))
        data = replace(clean, next_observations=clean.next_observations + noise)
        estimate = fit(data, starts=1)
        errors.append(estimate.distribution.mean - PLANTED)
        reported.append(estimate.diagnostics["std"])
    ratio = np.sqrt(np.mean(np.square(errors), axis=0) / np.mean(np.square(reported), axis=0))
    assert np.all((ratio > 0.5) & (ratio < 2))


def test_more_starts_never_end_at_a_higher_cost():
    data = recorded(waving_policy(), steps=20, noise=0.003)
    one, four = (fit(data, starts=n).diagnostics["costs"] for n in (1, 4))
    assert len(four) == 4
    assert four == sorted(four)
    assert four[0] <= one[0]


def test_steps_are_those_of_all_replays():
    data = recorded(waving_policy(), steps=20)
    estimate = fit(data, starts=1, steps=3)
    windows = len(data) // 3
    assert estimate.simulated_steps == estimate.diagnostics["replays"] * windows * 3


def test_the_plan_is_at_least_the_cost():
    data = recorded(waving_policy(), steps=20)
    settings = SysidSettings(starts=2, iterations=4)
    cost = Sysid(settings).fit(PROBLEM, data, stream("plan"), silent).simulated_steps
    assert cost <= settings.planned_steps(len(SPACE), len(data))


def test_parameters_that_the_data_leave_open_have_infinite_deviations():
    """A hanging arm at rest shows nothing of its masses and frictions."""
    still = recorded(waving_policy(), steps=5)
    hanging = np.zeros((len(still), 4))
    data = replace(
        still, observations=hanging, next_observations=hanging, actions=np.zeros((len(still), 2))
    )
    assert np.all(np.isinf(fit(data, starts=1).diagnostics["std"]))


def test_windows_longer_than_the_recording_are_refused():
    with pytest.raises(InvalidInput, match="no episode has 21 consecutive transitions"):
        fit(recorded(waving_policy(), steps=20), steps=21)


def test_a_diverged_replay_ends_the_search():
    data = recorded(waving_policy(), steps=5)
    absurd = data.observations.copy()
    absurd[:, 2:] = 1e9
    with pytest.raises(InvalidInput, match="a replay diverged"):
        fit(replace(data, observations=absurd))
