"""Measurements, fits and a criticism that the tests of criticism share."""

from dataclasses import replace

import numpy as np
import pytest

from adr_service.blind_test.planting import draw_case, hide
from adr_service.criticism.extension import extend
from adr_service.criticism.fits import fit, refine
from adr_service.criticism.measurements import Measurement
from adr_service.criticism.nominal import Nominal
from adr_service.criticism.pipeline import criticise
from adr_service.criticism.probable_states import smoothed
from adr_service.criticism.responses import Responses
from adr_service.criticism.scan import scan
from adr_service.criticism.simulator import Simulator
from adr_service.effects.base import Effect
from adr_service.parameters import ParameterSpace
from benchmarks.arms import hidden as planted_on
from benchmarks.arms import links_of, model_of
from benchmarks.arms import recorded as pushed_about
from tests.hidden import arm, recorded


@pytest.fixture(scope="session")
def good():
    """The arrays of a measurement of an arm with nothing wrong."""
    return recorded(draw_case(*arm(), np.random.default_rng(1), 0.3, count=0).measurement)


@pytest.fixture(scope="session")
def swinging():
    """A pendulum without actuators, and ten rows of one episode of it."""
    body = '<body><joint axis="0 1 0"/><geom size="0.1" pos="0.5 0 0"/></body>'
    xml = f"<mujoco><worldbody>{body}</worldbody></mujoco>"
    data = Measurement(
        time=0.02 * np.arange(10),
        qpos=np.linspace(0, 1, 10)[:, None],
        qvel=np.ones((10, 1)),
        ctrl=np.empty((10, 0)),
        episode=np.zeros(10, dtype=int),
    )
    return Nominal.of_model(xml, ParameterSpace(())), data


@pytest.fixture(scope="session")
def clean():
    """The arrays of an arm without any effect; noise of 1 mrad and 10 mrad/s."""
    task, nominal = arm()
    return recorded(hide(task, nominal, np.random.default_rng(403), []).episodes(range(8)))


@pytest.fixture(scope="session")
def friction():
    """The effect that `hidden` hides."""
    return Effect("joint_coulomb_friction", "joint:elbow", (0.1,))


@pytest.fixture(scope="session")
def hidden(friction):
    """A measurement of an arm with friction at the elbow."""
    return hide(*arm(), np.random.default_rng(404), [friction])


@pytest.fixture(scope="session")
def baseline(hidden):
    """A fit without the friction, to the first eight episodes."""
    data = hidden.episodes(range(8))
    sensor = data.sensor_variance()
    with Simulator(arm()[1], data, threads=1, finer=3) as simulator:
        yield smoothed(fit(simulator, sensor))


@pytest.fixture(scope="session")
def responses(baseline):
    """Responses of the fit without the friction to every effect."""
    return Responses(baseline)


@pytest.fixture(scope="session")
def candidates(baseline, responses):
    """Effects that a scan of that fit finds, the best first."""
    return scan(baseline, responses)


@pytest.fixture(scope="session")
def refined(baseline, friction):
    """A fit with the friction, from half of its strength."""
    return refine(baseline, [replace(friction, values=(0.05,))])


@pytest.fixture(scope="session")
def pushed_and_rubbing():
    """A fit to an arm of one axis in closed loop, whose model lacks Coulomb friction; torques that
    nobody recorded act on it, correlated in time."""
    rng, links = np.random.default_rng([1, 0]), links_of(1)
    bare = Nominal.of_model(model_of(links), ParameterSpace(()))
    effects = planted_on(links, rng)
    data = pushed_about(bare, links, effects, rng).episodes(range(25))
    known = [effect for effect in effects if effect.kind != "joint_coulomb_friction"]
    nominal = extend(bare, bare.start, known).nominal()
    with Simulator(nominal, data, threads=1) as simulator:
        yield smoothed(fit(simulator, data.sensor_variance()))


@pytest.fixture(scope="session")
def criticism():
    """A criticism that names one hidden effect, by the fewest episodes that are accepted."""
    case = draw_case(*arm(), np.random.default_rng(100), 0.3)
    return criticise(
        case.nominal, case.measurement.episodes(range(8)), np.random.default_rng(0), threads=1
    )


@pytest.fixture(scope="session")
def nothing():
    """A case with nothing hidden, and a criticism of twelve episodes of it."""
    case = draw_case(*arm(), np.random.default_rng(200), 0.3, count=0)
    return case, criticise(
        case.nominal, case.measurement.episodes(range(12)), np.random.default_rng(0), threads=1
    )
