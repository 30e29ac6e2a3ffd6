"""Inferences as stages, of an offline and of an online method."""

import io
from dataclasses import replace
from types import SimpleNamespace
from typing import Literal

import numpy as np
import pytest

from adr_service.distributions import Gaussian, Uniform
from adr_service.errors import InvalidInput
from adr_service.methods.base import Estimate, OfflineSettings
from adr_service.methods.dropo import DropoSettings
from adr_service.methods.simopt import SimOpt, SimOptSettings
from adr_service.methods.sysid import SysidSettings
from adr_service.stages.base import compute
from adr_service.stages.infer import Infer, packed, unpacked
from tests.planted import PLANTED, PROBLEM, SPACE, distance, recorded, waving_policy
from tests.stages.examples import Speed

SIMOPT = SimOptSettings(updates=1, samples=10)
OFFLINE = Infer(
    task="arm",
    variant="vanilla",
    seed=0,
    method=SysidSettings(starts=1, iterations=10),
    data=recorded(waving_policy(), steps=20).to_npz(),
)
ONLINE = replace(
    OFFLINE,
    method=SIMOPT,
    state=SimOpt(SIMOPT).start(PROBLEM),
    policy=waving_policy().to_bytes(),
)


@pytest.fixture(scope="module")
def offline():
    return OFFLINE.read(compute(OFFLINE))


@pytest.fixture(scope="module")
def online():
    return ONLINE.read(compute(ONLINE))


def test_an_offline_method_answers_in_the_space_of_its_variant(offline):
    assert isinstance(offline.distribution, Uniform)
    assert offline.distribution.space == OFFLINE.space == SPACE
    assert distance(offline.distribution.mean) < distance(Gaussian.prior(SPACE).mean)
    np.testing.assert_allclose(offline.distribution.mean, PLANTED, rtol=0.05)


def test_an_offline_method_has_no_state_and_an_online_one_has(offline, online):
    assert offline.state is None
    assert online.state is not None
    assert online.state != ONLINE.state


def test_an_online_method_answers_with_the_distribution_of_its_new_state(online):
    asked = SimOpt(SIMOPT).ask(PROBLEM, online.state)
    assert online.distribution.to_json() == asked.to_json()


@pytest.mark.parametrize("stage", [OFFLINE, ONLINE], ids=["offline", "online"])
def test_its_cost_covers_what_it_simulates(stage, request):
    result = request.getfixturevalue("offline" if stage is OFFLINE else "online")
    planned = stage.cost(Speed(1.0)).seconds
    assert 0 < result.simulated_steps <= planned
    assert stage.cost(Speed(10.0)).seconds == pytest.approx(planned / 10)


def test_more_data_cost_more():
    longer = replace(OFFLINE, data=recorded(waving_policy(), steps=40).to_npz())
    assert longer.cost(Speed()).seconds > OFFLINE.cost(Speed()).seconds


def test_earlier_visits_cost_as_much_as_the_last():
    seen = packed([(ONLINE.policy, recorded(waving_policy(), steps=20))])
    once, twice = (stage.cost(Speed()).seconds for stage in (ONLINE, replace(ONLINE, earlier=seen)))
    assert twice == pytest.approx(2 * once)


def test_a_stand_in_has_a_state_only_after_a_state():
    assert OFFLINE.stand_in().state is None
    assert ONLINE.stand_in().state is not None


def test_a_stand_in_has_the_criterion_by_which_a_grid_is_decided():
    gridded = replace(OFFLINE, method=DropoSettings())
    assert DropoSettings.grid.criterion in gridded.stand_in().diagnostics


def test_data_that_are_no_recording_are_refused():
    with pytest.raises(InvalidInput, match=r"not a readable \.npz"):
        compute(replace(OFFLINE, data=b"measured"))


def test_a_mean_at_a_bound_is_named(offline, online):
    assert offline.diagnostics["at_bound"] == online.diagnostics["at_bound"] == []
    heavy = PLANTED.copy()
    heavy[0] = SPACE.high[0]
    data = recorded(waving_policy(), heavy, steps=20).to_npz()
    stage = replace(OFFLINE, data=data)
    assert stage.read(compute(stage)).diagnostics["at_bound"] == [SPACE.names[0]]


def test_earlier_visits_of_more_bytes_than_an_upload_may_have_numbers_are_read_back():
    policy, data = bytes(2**25), recorded(waving_policy(), steps=20)
    ((kept, seen),) = unpacked(packed([(policy, data)]))
    assert kept == policy
    assert seen.to_npz() == data.to_npz()


def test_earlier_visits_that_unpack_to_more_than_their_file_are_refused():
    buffer = io.BytesIO()
    np.savez_compressed(buffer, policy_0=np.zeros(10_000, np.uint8), data_0=np.zeros(1, np.uint8))
    with pytest.raises(InvalidInput, match="holds 10001 numbers"):
        unpacked(buffer.getvalue())


def of_a_plug_in(fit=None, planned_steps=lambda: 10):
    """The offline stage with a method of a user's own, under a name of the catalogue."""

    class OwnSettings(OfflineSettings):
        name: Literal["sysid"] = "sysid"

        def create(self):
            return SimpleNamespace(fit=lambda *_: fit())

        def planned_steps(self, parameters, transitions):
            return planned_steps()

    return replace(OFFLINE, method=OwnSettings())


def test_a_distribution_over_the_parameters_in_another_order_is_refused():
    turned = SPACE.subset(SPACE.names[::-1])
    stage = of_a_plug_in(lambda: Estimate(Gaussian.prior(turned), 10))
    with pytest.raises(InvalidInput, match="the distribution of sysid is over elbow_friction, "):
        compute(stage)


@pytest.mark.parametrize(
    ("found", "message"),
    [
        (np.zeros(3), "error in diagnostics of infer is of type ndarray, which is not JSON"),
        (np.int64(3), "error in diagnostics of infer is of type int64, which is not JSON"),
        (np.nan, "error in diagnostics of infer is nan, which is not a JSON number"),
        ([1.0, -np.inf], "an item of error in diagnostics of infer is -inf, which"),
        ({"of": {1: "one"}}, "a key in of in error in diagnostics of infer must be text; given 1"),
    ],
    ids=["array", "integer", "NaN", "infinity", "key"],
)
def test_diagnostics_that_are_not_json_are_refused_by_their_name(found, message):
    stage = of_a_plug_in(lambda: Estimate(Gaussian.prior(SPACE), 10, {"error": found}))
    with pytest.raises(InvalidInput, match=message):
        compute(stage)


def test_diagnostics_that_are_json_stay_as_they_are():
    found = {"none": None, "many": [1, 2.5, [True, "text"]], "float": np.float64(0.1)}
    stage = of_a_plug_in(lambda: Estimate(Gaussian.prior(SPACE), 10, found))
    assert compute(stage).values["diagnostics"] == {**found, "at_bound": []}


@pytest.mark.parametrize(
    "given", [None, np.nan, np.inf, -1, "many"], ids=["None", "NaN", "infinity", "minus", "text"]
)
def test_planned_steps_that_are_no_number_of_steps_are_refused(given):
    message = f"planned_steps of sysid must be a finite number of 0 or more; it gave {given!r}"
    with pytest.raises(InvalidInput, match=message):
        of_a_plug_in(planned_steps=lambda: given).cost(Speed())


def test_planned_steps_that_raise_are_refused_with_the_reason():
    def divided():
        return 1 / 0

    with pytest.raises(InvalidInput, match="planned_steps of sysid raised ZeroDivisionError: "):
        of_a_plug_in(planned_steps=divided).cost(Speed())


def test_planned_steps_may_be_a_number_of_numpy():
    plain = of_a_plug_in(planned_steps=lambda: 1000)
    of_numpy = of_a_plug_in(planned_steps=lambda: np.int64(1000))
    assert of_numpy.cost(Speed()) == plain.cost(Speed())
