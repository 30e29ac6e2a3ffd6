"""Link lengths as parameters, on the example package's rod and on Walker2d."""

import dataclasses
import importlib

import numpy as np
import pytest

from adr_service.errors import InvalidInput
from adr_service.parameters import Parameter, ParameterSpace
from adr_service.simulation.batch import Simulations
from adr_service.tasks.base import Source
from adr_service.tasks.catalogue import get_task, source_of
from tests.packages import ROOT


@pytest.fixture
def pendulum(monkeypatch):
    monkeypatch.syspath_prepend(str(ROOT / "docs/examples/adr-pendulum"))
    return importlib.import_module("adr_pendulum").Pendulum()


def source(*parameters, **fixed):
    space = tuple(Parameter(f"p{i}", a, "1", 0.3, 2.0, 0.1) for i, a in enumerate(parameters))
    return Source(ParameterSpace(space), {f"body:rod.{k}": v for k, v in fixed.items()})


def test_fixed_values_stay_whatever_length_is_drawn(pendulum):
    class Heavier(type(pendulum)):
        def reshape(self, spec, lengths):
            super().reshape(spec, lengths)
            spec.body("rod").mass = lengths.get("rod", 1.0)

    simulations = Simulations(Heavier(), source("link:rod.length", mass=2.5), 2)
    simulations.set_dynamics(np.array([[0.5], [1.5]]))
    for row, length in enumerate((0.5, 1.5)):
        assert simulations.model(row).body("rod").mass[0] == 2.5
        assert simulations.model(row).geom("rod").size[1] == length / 2


def test_a_fixed_length_is_in_the_model_from_the_start(pendulum):
    fixed = Source(ParameterSpace(()), {"link:rod.length": 1.4})
    simulations = Simulations(pendulum, fixed, 1)
    assert simulations.model(0).geom("rod").size[1] == 0.7


def test_equal_and_repeated_draws_give_equal_models():
    space = source_of("walker2d", "vanilla").space
    simulations = Simulations(get_task("walker2d"), source_of("walker2d", "vanilla"), 3)
    short, long = space.low, space.high
    simulations.set_dynamics(np.array([short, long, short]))
    simulations.set_dynamics(np.array([long, long, short]))
    sizes = [simulations.model(row).geom_size for row in range(3)]
    np.testing.assert_array_equal(sizes[0], sizes[1])
    assert np.any(sizes[0] != sizes[2])


@pytest.mark.parametrize(
    ("parameters", "fixed", "message"),
    [
        (["link:rodd.length"], {}, "link:rodd.length changes nothing"),
        (["link:rod.length", "body:rod.inertial"], {}, "use body:….mass"),
        (["link:rod.length"], {"inertial": 2.0}, "use body:….mass"),
    ],
)
def test_a_length_that_changes_nothing_or_clashes_with_an_inertia_is_refused(
    pendulum, parameters, fixed, message
):
    with pytest.raises(InvalidInput, match=message):
        Simulations(pendulum, source(*parameters, **fixed), 1)


def test_a_task_that_cannot_be_reshaped_has_no_lengths():
    lengths = Source(ParameterSpace((Parameter("l", "link:fore.length", "m", 0.3, 1, 0.1),)))
    with pytest.raises(InvalidInput, match="arm cannot be reshaped, so the lengths of fore"):
        Simulations(get_task("arm"), lengths, 1)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"xml": ("autoreset", "eulerdamp")}, 'autoreset="disable"'),
        ({"action_low": [-1.0, -1.0]}, "bounds 2 and 1 actions"),
        ({"measured": 4}, "measures 4 of 3 columns"),
    ],
)
def test_a_reshapable_task_whose_parts_do_not_fit_is_refused(pendulum, change, message):
    if "xml" in change:
        change = {"xml": pendulum.xml.replace(*change["xml"])}
    task = dataclasses.replace(pendulum, **change)
    with pytest.raises(InvalidInput, match=message):
        Simulations(task, source("body:rod.mass"), 1)
