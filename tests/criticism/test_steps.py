"""The simulator's step, chosen again once causes are in."""

from dataclasses import replace

import mujoco
import numpy as np
import pytest

from adr_service.blind_test.planting import hide
from adr_service.criticism import steps
from adr_service.criticism.fits import fit, refine
from adr_service.criticism.pipeline import criticise
from adr_service.criticism.probable_states import smoothed
from adr_service.criticism.simulator import Simulator
from adr_service.criticism.steps import in_finer_steps, in_steps_of
from adr_service.effects.base import Effect
from tests.hidden import arm

STRONG = Effect("joint_stribeck_friction", "joint:elbow", (0.6, 0.8))


@pytest.fixture(scope="module")
def sticking():
    """An arm whose elbow sticks and then lets go."""
    return hide(*arm(), np.random.default_rng(405), [STRONG])


@pytest.fixture(scope="module")
def in_thirds(sticking):
    """A fit with the friction, in a third of the model's step."""
    data = sticking.episodes(range(8))
    with Simulator(arm()[1], data, threads=1, finer=3) as simulator:
        baseline = smoothed(fit(simulator, data.sensor_variance()))
        yield smoothed(refine(baseline, [STRONG]))


@pytest.fixture(scope="module")
def finer(in_thirds):
    """The same fit in the steps that it asks for."""
    return in_finer_steps(in_thirds, 1)


@pytest.mark.slow
def test_a_friction_that_sticks_asks_for_finer_steps_which_bring_it_nearer_to_the_truth(
    in_thirds, finer
):
    assert finer.simulator.finer == 9
    fall, finer_fall = (each.effects[0].values[1] for each in (in_thirds, finer))
    assert abs(finer_fall - STRONG.values[1]) < 0.5 * abs(fall - STRONG.values[1])
    np.testing.assert_allclose(finer.effects[0].values, STRONG.values, rtol=0.03)


@pytest.mark.slow
def test_finer_steps_are_not_tried_again_where_they_are_fine_enough(finer):
    assert in_finer_steps(finer, 1) is finer
    assert "in_finer_steps" not in vars(finer.simulator)


def test_finer_steps_that_are_not_likelier_beyond_chance_are_refused(in_thirds, monkeypatch):
    monkeypatch.setattr(steps, "gained", lambda finer, current: np.full(8, 0.1))
    assert in_finer_steps(in_thirds, 1) is in_thirds


@pytest.mark.parametrize(("before", "after"), [(0, 1), (1, 0)])
def test_finer_steps_are_taken_for_more_transitions_and_refused_for_fewer(
    in_thirds, monkeypatch, before, after
):
    """Likelihoods of other transitions are compared with nothing."""

    def without(fit, count):
        mask = fit.linear.chain.mask.copy()
        mask[0, :count] = False
        linear = replace(fit.linear, chain=replace(fit.linear.chain, mask=mask))
        return replace(fit, linear=linear)

    def finer_steps(fit, simulator):
        return without(replace(in_thirds, simulator=simulator), after)

    monkeypatch.setattr(steps, "in_steps_of", finer_steps)
    monkeypatch.setattr(steps, "_are_pulled", lambda current, newest: True)
    monkeypatch.setattr(steps, "gained", None)  # would be called for equal numbers alone
    begun = without(in_thirds, before)
    found = in_finer_steps(begun, 1)
    assert found.simulator.finer == (9 if before > after else 3)


def test_an_integrator_of_fourth_order_keeps_its_steps(in_thirds, monkeypatch):
    fourth = mujoco.mjtIntegrator.mjINT_RK4
    monkeypatch.setattr(in_thirds.simulator.base.opt, "integrator", fourth)
    assert in_finer_steps(in_thirds, 1) is in_thirds


def test_a_fit_whose_strengths_come_far_is_smoothed_with_derivatives_anew(in_thirds):
    """One round alone, with the derivatives of a friction half as strong, ends before the best."""
    weak = replace(STRONG, values=(0.3, 0.4))
    begun = replace(in_thirds, effects=(weak,))
    finer = in_steps_of(begun, in_thirds.simulator.in_finer_steps)
    np.testing.assert_allclose(finer.effects[0].values, STRONG.values, rtol=0.03)


def test_steps_stay_where_finer_ones_change_nothing_of_what_a_cause_does(baseline):
    """A force on a command acts alike in any step."""
    pushed = Effect("actuator_bias", "actuator:elbow", (0.1,))
    fitted = smoothed(refine(baseline, [pushed]))
    assert in_finer_steps(fitted, 1) is fitted
    assert vars(baseline.simulator).get("in_finer_steps") is None  # nor were any tried


@pytest.mark.parametrize(("size", "is_pulled"), [(0.0, False), (0.05, True)])
def test_what_changes_no_strength_asks_for_no_finer_steps(in_thirds, monkeypatch, size, is_pulled):
    """However much it changes of the predictions: here by a fifth of the noise, and by what so much
    more friction would do."""
    simulator, columns = in_thirds.simulator, in_thirds.linear.columns[in_thirds.linear.chain.mask]
    more = size * STRONG.values[0] * columns[..., in_thirds.columns_of(slice(0, 1)).start]
    noise = np.sqrt(in_thirds.noise.sensor) * np.random.default_rng(0).normal(size=more.shape)
    changed = {1: noise / 5 + more, 0: 0.0}

    def finely(values, effects, states, **_):
        return simulator.predict(values, effects, states) + changed[len(effects)]

    monkeypatch.setattr(simulator, "predict_finer", finely)
    assert steps._are_pulled(in_thirds, 1) is is_pulled


def test_effects_in_sensors_ask_for_no_finer_steps(baseline):
    """They are not integrated, so nothing is simulated to find that out."""
    biased = refine(baseline, [Effect("sensor_bias", "sensor:elbow.position", (0.01,))])
    spent = biased.simulator.simulated_steps
    assert not steps._are_pulled(biased, 1)
    assert biased.simulator.simulated_steps == spent


def test_a_simulator_in_finer_steps_predicts_quickly_in_the_larger_ones(in_thirds):
    simulator = in_thirds.simulator
    known = (in_thirds.parameters, in_thirds.effects, in_thirds.states)
    quickly = simulator.in_finer_steps.predict_quickly(*known)
    np.testing.assert_allclose(quickly, simulator.predict(*known), rtol=1e-9)


@pytest.mark.slow
def test_a_friction_that_sticks_is_named_alone_with_the_true_strengths(sticking):
    """In a third of the step it came out a sixth too small, beside a rotor that is not there."""
    found = criticise(arm()[1], sticking, np.random.default_rng(0), threads=1)
    # what is compared takes the same steps
    assert found.baseline.simulator is found.final.simulator
    (cause,) = found.verdict.causes
    assert (cause.kind, cause.location) == (STRONG.kind, STRONG.location)
    for strength, true in zip(cause.strengths, STRONG.values, strict=True):
        assert strength.value == pytest.approx(true, rel=0.05)
