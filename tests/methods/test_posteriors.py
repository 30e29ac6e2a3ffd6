"""Plans, diagnostics and refusals of BayesSim and NPDR."""

from dataclasses import replace

import numpy as np
import pytest

from adr_service.errors import InvalidInput
from adr_service.methods.bayes_sim import BayesSimSettings
from adr_service.methods.npdr import NpdrSettings
from adr_service.progress import StageCancelled, silent
from adr_service.randomness import stream
from tests.planted import PROBLEM, recorded, waving_policy

DATA = recorded(waving_policy(), steps=20)
FEW = {"simulations": 40, "epochs": 2}


def fit(settings, data=DATA):
    return settings.create().fit(PROBLEM, data, stream("posteriors"), silent)


def test_plans_grow_with_the_simulations_that_a_network_is_trained_on():
    assert BayesSimSettings().seconds == 20
    assert BayesSimSettings(simulations=20_000).seconds == 200
    assert NpdrSettings().seconds == 40
    assert NpdrSettings(simulations=5000).seconds == 400
    assert NpdrSettings(rounds=1, simulations=2000).seconds == 16


def test_a_validation_with_fewer_atoms_than_the_training_is_a_diagnostic_of_npdr():
    few = fit(NpdrSettings(rounds=2, draws=20, **FEW))
    enough = fit(NpdrSettings(rounds=2, draws=20, epochs=2, simulations=50))
    assert few.diagnostics["validation_atoms"] == 8
    assert "validation_atoms" not in enough.diagnostics


@pytest.mark.parametrize("settings", [BayesSimSettings, NpdrSettings])
def test_an_inference_that_nobody_wants_stops_between_batches_of_replays(settings):
    seen = []

    def cancelled_at_the_second(fraction, **_):
        seen.append(fraction)
        if len(seen) == 2:
            raise StageCancelled

    method = settings(simulations=1000).create()
    with pytest.raises(StageCancelled):
        method.fit(PROBLEM, DATA, stream("posteriors"), cancelled_at_the_second)
    assert 0 < seen[0] < seen[1] < 0.5


@pytest.mark.parametrize("settings", [BayesSimSettings(**FEW), NpdrSettings(rounds=2, **FEW)])
def test_replays_are_half_of_the_work(settings):
    seen = []
    settings.create().fit(PROBLEM, DATA, stream("posteriors"), lambda done, **_: seen.append(done))
    assert seen == sorted(seen)
    assert [done for done in seen if done == 1.0] == [1.0]


@pytest.mark.parametrize("settings", [BayesSimSettings(**FEW), NpdrSettings(rounds=1, **FEW)])
def test_a_recording_whose_replays_no_parameter_changes_is_refused(settings):
    """An arm that hangs at rest stays there, whatever its masses are."""
    rest, none = np.zeros((len(DATA), 4)), np.zeros((len(DATA), 2))
    still = replace(DATA, observations=rest, next_observations=rest, actions=none)
    with pytest.raises(InvalidInput, match="no statistic of the replays depends on the parameters"):
        fit(settings, still)


@pytest.mark.parametrize("settings", [BayesSimSettings(**FEW), NpdrSettings(rounds=1, **FEW)])
def test_rows_that_do_not_follow_one_another_are_refused(settings):
    order = np.random.default_rng(0).permutation(len(DATA))
    arrays = ("observations", "actions", "next_observations")
    shuffled = replace(DATA, **{name: getattr(DATA, name)[order] for name in arrays})
    with pytest.raises(InvalidInput, match="need rows that follow one another"):
        fit(settings, shuffled)
    assert fit(settings.model_copy(update={"segment": 1}), shuffled).simulated_steps == 800
