"""The contract of a mechanism, over all of the catalogue and several tasks."""

import numpy as np
import pytest

from adr_service.criticism.extension import extend
from adr_service.criticism.measurements import Measurement
from adr_service.criticism.nominal import Nominal
from adr_service.criticism.simulator import Simulator
from adr_service.effects.base import Effect
from adr_service.effects.catalogue import MECHANISMS, get_mechanism
from adr_service.effects.models import typical_of
from adr_service.effects.signals import behind, recorded, shown
from adr_service.tasks.catalogue import get_task, source_of

ROWS = 27  # of an episode


def small(name):
    """A task's simulator and a short recording that moves every joint."""
    task, rng = get_task(name), np.random.default_rng(0)
    nominal = Nominal.of_task(task, source_of(name, "vanilla"))
    state = task.initial(1, rng)
    rows = 4 * ROWS
    qpos = state.qpos + 0.1 * rng.standard_normal((rows, state.qpos.shape[1]))
    period = nominal.model(nominal.start).opt.timestep * task.frame_skip
    return Simulator(
        nominal,
        Measurement(
            time=np.tile(np.arange(ROWS) * period, 4),
            qpos=qpos,
            qvel=rng.standard_normal((rows, state.qvel.shape[1])),
            ctrl=rng.uniform(task.action_low, task.action_high, (rows, len(task.action_low))),
            episode=np.repeat(np.arange(4), ROWS),
        ),
        threads=1,
    )


@pytest.fixture(scope="module", params=["arm", "hopper", "half_cheetah"])
def simulator(request):
    return small(request.param)


def typical(model, kind, place):
    """The effect of a kind at a place, as strong as a sensible simulator might lack."""
    return Effect(kind, place, tuple(typical_of(model, kind, place).tolist()))


def nothing(kind, place):
    """The effect of a kind at a place with zero strengths."""
    return Effect(kind, place, (0.0,) * len(get_mechanism(kind).strengths))


@pytest.mark.parametrize("kind", MECHANISMS)
def test_zero_strength_changes_no_trajectory_by_a_bit(kind, simulator):
    start = simulator.nominal.start
    for place in get_mechanism(kind).locations(simulator.base)[-2:]:
        without, with_it = (
            simulator.predict(start, effects, simulator.measured)
            for effects in ((), [nothing(kind, place)])
        )
        np.testing.assert_array_equal(with_it, without)


@pytest.mark.parametrize("kind", MECHANISMS)
def test_an_effect_moves_predictions_and_is_the_same_when_written_out(kind, simulator):
    mechanism, start = get_mechanism(kind), simulator.nominal.start
    without = simulator.predict(start, [], simulator.measured)
    for place in mechanism.locations(simulator.base)[-2:]:
        effect = typical(simulator.base, kind, place)
        changed = simulator.predict(start, [effect], simulator.measured)
        extension = extend(simulator.nominal, start, [effect])
        again = Simulator(extension.nominal(), simulator.data, threads=1)
        written = again.predict(np.empty(0), extension.beside, again.measured)
        np.testing.assert_allclose(written, changed, rtol=0, atol=1e-9)
        # the arm has no contacts
        if not kind.startswith("contact") and not mechanism.only_spreads:
            assert np.nanmax(np.abs(changed - without)) > 0


@pytest.mark.parametrize("kind", MECHANISMS)
def test_typical_strengths_are_possible_and_one_for_each(kind, simulator):
    mechanism = get_mechanism(kind)
    for place in mechanism.locations(simulator.base):
        values = typical(simulator.base, kind, place).values
        lows = [strength.low for strength in mechanism.strengths]
        assert len(values) == len(lows)
        assert np.all(np.isfinite(values))
        assert np.all(np.array(values) >= lows)
        assert np.all(np.array(values) > 0)


@pytest.mark.parametrize("kind", [k for k, m in MECHANISMS.items() if m.sensing is not None])
def test_an_effect_in_a_sensor_is_undone_as_it_was_applied(kind, simulator):
    """To first order: strengths are small, and rates are those of the true states in both."""
    true, rates = simulator.measured, np.random.default_rng(1).normal(size=simulator.measured.shape)
    for place in get_mechanism(kind).locations(simulator.base):
        effect = typical(simulator.base, kind, place)
        readings = shown(simulator.base, [effect], true, rates, simulator.sensors.past)
        np.testing.assert_allclose(
            behind(simulator.base, [effect], readings, rates, simulator.sensors.past),
            true,
            atol=1e-12,
        )


@pytest.mark.parametrize(
    "kind", [k for k, m in MECHANISMS.items() if m.sensing and not m.only_spreads]
)
def test_exact_readings_of_zero_strength_are_the_truth(kind, simulator):
    states = simulator.measured.reshape(4, ROWS, -1)
    for place in get_mechanism(kind).locations(simulator.base):
        effect = nothing(kind, place)
        readings = recorded(simulator.base, [effect], states, simulator.period)
        np.testing.assert_array_equal(readings, states)


def test_every_place_has_a_name(simulator):
    places = [p for m in MECHANISMS.values() for p in m.locations(simulator.base)]
    assert "global" in places
    assert all(place == "global" or place.split(":")[1] for place in places)


@pytest.mark.parametrize("kind", [k for k, m in MECHANISMS.items() if m.includes])
def test_a_mechanism_includes_a_smaller_one_at_its_places(kind, simulator):
    mechanism = get_mechanism(kind)
    smaller = get_mechanism(mechanism.includes)
    assert len(smaller.strengths) < len(mechanism.strengths)
    assert set(mechanism.locations(simulator.base)) <= set(smaller.locations(simulator.base))
