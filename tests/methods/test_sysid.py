"""System identification's answer, its standard deviations, and its refusals."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import OptimizeResult

from adr_service.distributions import Uniform, normalised_std
from adr_service.errors import InvalidInput
from adr_service.methods.base import Problem
from adr_service.methods.sysid import (
    Sysid,
    SysidLaplaceSettings,
    SysidSettings,
    SysidWideSettings,
)
from adr_service.parameters import Parameter, ParameterSpace
from adr_service.progress import silent
from adr_service.randomness import stream
from adr_service.simulation.replay import Replay
from adr_service.tasks.base import Source
from tests.planted import ARM, PLANTED, PROBLEM, SPACE, distance, recorded, stuck, waving_policy


def fitted(settings, data):
    return settings.create().fit(PROBLEM, data, stream("s"), silent)


def fit(data, **settings):
    return fitted(SysidSettings(**settings), data)


def test_the_answer_is_one_point():
    estimate = fit(recorded(waving_policy(), steps=20), starts=1)
    assert isinstance(estimate.distribution, Uniform)
    assert np.all(estimate.distribution.std == 0)


def test_a_stuck_sensor_does_not_outweigh_the_others():
    estimate = fit(stuck(recorded(waving_policy(), steps=40), column=1, value=0.1), starts=1)
    assert distance(estimate.distribution.mean) < 0.5
    assert not SPACE.at_bound(estimate.distribution.mean)


def test_standard_deviations_are_those_of_repeated_recordings():
    """Root mean squares over 12 recordings err by a fifth, and over all parameters by a tenth.

    The noise is on outputs.
    """
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
    pooled = np.sqrt(np.mean(np.square(np.array(errors) / np.array(reported))))
    assert 0.75 < pooled < 1.33


def test_a_box_lies_around_the_point_and_keeps_what_is_feasible():
    data = recorded(waving_policy(), steps=20)
    point = fit(data, starts=1).distribution.mean
    box = fitted(SysidWideSettings(starts=1, width=0.2), data).distribution
    np.testing.assert_allclose(box.low, 0.8 * point)
    np.testing.assert_allclose(box.high, 1.2 * point)
    barely = np.array([SPACE.feasible_low[0], *point[1:]])
    end = OptimizeResult(x=SPACE.normalise(barely))
    assert SysidWideSettings().distribution(SPACE, end, 4).low[0] >= SPACE.feasible_low[0]


def test_laplaces_deviations_are_those_of_the_residuals_where_data_tell():
    clean = recorded(waving_policy())
    noise = 0.003 * np.random.default_rng(0).standard_normal((len(clean), 4))
    estimate = fitted(
        SysidLaplaceSettings(starts=1),
        replace(clean, next_observations=clean.next_observations + noise),
    )
    ratio = estimate.distribution.std / estimate.diagnostics["std"]
    assert np.all((ratio > 0.5) & (ratio < 2))


def test_laplaces_gaussian_is_as_wide_as_its_mean_errs():
    """Squared errors of the mean, in the Gaussian's own deviations, are 1 on average."""
    squares = []
    for seed in range(8):
        rng = np.random.default_rng(seed)
        truth = SPACE.denormalise(rng.normal(2, 1, len(SPACE)).clip(0.3, 3.7))
        clean = recorded(waving_policy(), dynamics=truth, steps=120, seed=seed)
        noise = 0.01 * rng.standard_normal((len(clean), 4))
        data = replace(clean, next_observations=clean.next_observations + noise)
        found = fitted(SysidLaplaceSettings(starts=1), data).distribution
        errors = found.location - SPACE.normalise(truth)
        squares.append(errors @ np.linalg.solve(found.covariance, errors) / len(SPACE))
    assert 0.3 < np.mean(squares) < 2


def test_laplaces_mean_is_the_priors_where_data_say_nothing():
    rng = np.random.default_rng(0)
    end = OptimizeResult(x=np.full(4, 3.0), jac=np.zeros((30, 4)), fun=rng.standard_normal(30))
    mean = SysidLaplaceSettings().distribution(SPACE, end, 3).mean
    np.testing.assert_allclose(SPACE.normalise(mean), 2.0)


def test_laplaces_mean_is_the_mode_within_the_search_box():
    """Two parameters whose sum is known: where one would lie beyond its bound, the other makes up
    for it."""
    jacobian = np.zeros((40, 4))
    jacobian[:20, :2] = 1.0
    jacobian[20:, :] = 0.02 * np.eye(4).repeat(5, axis=0)
    residuals = np.tile([0.01, -0.01], 20)
    residuals[20:25] -= 0.03  # wants the first parameter larger
    end = OptimizeResult(x=np.array([3.9, 1.0, 2.0, 2.0]), jac=jacobian, fun=residuals)
    found = SysidLaplaceSettings().distribution(SPACE, end, 1)
    assert found.location[0] == 4
    assert found.location[:2].sum() == pytest.approx(4.9, abs=0.01)

    def loss(point):
        deviation = np.sqrt(np.mean(residuals**2))
        step = (residuals + jacobian @ (point - end.x)) / deviation
        return step @ step + np.sum((point - 2) ** 2)

    for nearby in np.vstack([np.eye(4), -np.eye(4)]) * 1e-3:
        assert loss((found.location + nearby).clip(0, 4)) >= loss(found.location)


def test_laplaces_deviations_are_the_priors_where_data_say_nothing():
    rng = np.random.default_rng(0)
    end = OptimizeResult(x=np.full(4, 2.0), jac=np.zeros((30, 4)), fun=rng.standard_normal(30))
    np.testing.assert_allclose(
        SysidLaplaceSettings().distribution(SPACE, end, 3).covariance, np.eye(4)
    )


def test_laplaces_deviations_are_narrow_without_noise():
    estimate = fitted(SysidLaplaceSettings(starts=1), recorded(waving_policy()))
    assert np.all(normalised_std(estimate.distribution) < 0.005)


def test_a_bias_is_no_certainty():
    end = OptimizeResult(x=np.full(4, 2.0), jac=np.eye(4), fun=np.full(4, 0.5))
    covariance = SysidLaplaceSettings().distribution(SPACE, end, 1).covariance
    np.testing.assert_allclose(covariance, np.eye(4) / (1 + 1 / 0.5**2))


def test_laplaces_deviations_stay_wide_where_only_ratios_can_be_told():
    """Masses, frictions, armatures and gears of an arm share a scale that no motion shows."""
    places = ["body:upper.inertial", "body:fore.inertial", "joint:shoulder.damping"]
    places += ["joint:elbow.damping", "joint:shoulder.armature", "joint:elbow.armature"]
    places += ["actuator:shoulder.gear", "actuator:elbow.gear"]
    bounds = [(0.2, 5.0)] * 2 + [(0.0, 8.0)] * 2 + [(0.0, 1.0)] * 2 + [(1.0, 60.0)] * 2
    parameters = zip(places, bounds, strict=True)
    space = ParameterSpace(tuple(Parameter(p, p, "SI", *b, max(b[0], 0.0)) for p, b in parameters))
    settings = SysidLaplaceSettings(starts=1)
    data = recorded(waving_policy(), steps=60)
    found = settings.create().fit(Problem(ARM, Source(space)), data, stream("s"), silent)
    assert normalised_std(found.distribution).max() > 0.3


def test_laplaces_deviations_are_finite_where_data_tell_one_parameter_alone():
    jacobian = np.zeros((30, 4))
    jacobian[:, 0] = 1e9
    end = OptimizeResult(x=np.full(4, 2.0), jac=jacobian, fun=np.zeros(30))
    covariance = SysidLaplaceSettings().distribution(SPACE, end, 3).covariance
    np.testing.assert_allclose(np.diag(covariance), [1e-12, 1, 1, 1])


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


def test_searches_that_the_iterations_ended_are_counted():
    data = recorded(waving_policy(), steps=20)
    cut, whole = fit(data, starts=2, iterations=2), fit(data, starts=2)
    assert cut.diagnostics["unconverged_searches"] == 2
    assert not {"unconverged_searches", "left_out_searches"} & whole.diagnostics.keys()


def test_the_plan_is_at_least_the_cost():
    data = recorded(waving_policy(), steps=20)
    settings = SysidSettings(starts=2, iterations=4)
    cost = Sysid(settings).fit(PROBLEM, data, stream("plan"), silent).simulated_steps
    assert cost <= settings.planned_steps(len(SPACE), len(data))


def test_parameters_that_the_data_leave_open_have_no_deviation():
    """A hanging arm at rest shows nothing of its masses and frictions."""
    still = recorded(waving_policy(), steps=5)
    hanging = np.zeros((len(still), 4))
    data = replace(
        still, observations=hanging, next_observations=hanging, actions=np.zeros((len(still), 2))
    )
    assert fit(data, starts=1).diagnostics["std"] == [None] * len(SPACE)


def test_windows_longer_than_the_recording_are_refused():
    with pytest.raises(InvalidInput, match="no episode has 21 consecutive transitions"):
        fit(recorded(waving_policy(), steps=20), steps=21)


def test_searches_keep_away_from_points_whose_replay_diverges(monkeypatch):
    """One of the four starts lies where nothing can be simulated; others would step into it."""
    data, known = recorded(waving_policy(), steps=20), Replay.predict

    def predict(replay, values):
        predictions, mass = known(replay, values), SPACE.normalise(values)[:, 0]
        predictions[(mass > 1.3) & (mass < 1.6)] = np.nan
        return predictions

    monkeypatch.setattr(Replay, "predict", predict)
    estimate = fit(data)
    assert len(estimate.diagnostics["costs"]) == 3
    assert estimate.diagnostics["left_out_searches"] == 1
    assert estimate.diagnostics["diverged_replays"] > 1, "no search stepped into it"
    assert np.allclose(estimate.distribution.mean, PLANTED)


def test_recordings_that_no_simulator_can_replay_are_refused():
    data = recorded(waving_policy(), steps=5)
    absurd = data.observations.copy()
    absurd[:, 2:] = 1e9
    diverged = r"a replay diverged at \w+ [\d.]+, .*, and none of 4 searches could go on"
    with pytest.raises(InvalidInput, match=diverged):
        fit(replace(data, observations=absurd))
