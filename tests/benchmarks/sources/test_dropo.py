"""DROPO's Hopper of an older engine, criticised."""

import numpy as np
import pytest

from adr_service.criticism.pipeline import criticise
from adr_service.criticism.simulator import Simulator
from adr_service.errors import InvalidInput
from benchmarks.sources import dropo


@pytest.mark.slow
def test_what_todays_hopper_lacks_of_an_older_engine_is_named(datasets):
    """Inertias and masses of all bodies, and the contact margin (MuJoCo 2.1 against 4.0).

    Learned from 6 of 20 episodes; the error is of all of them. The masses are published.
    """
    folder = datasets / "dropo_hopper" / "hopper10000"
    nominal = dropo.nominal()
    criticism = criticise(nominal, dropo.read(folder, episodes=6), np.random.default_rng(0))
    causes = {(c.kind, c.location): c for c in criticism.verdict.causes}
    assert set(list(causes)[:2]) == {("body_inertia", "body:*"), ("body_mass", "body:*")}
    assert list(causes)[2:] == [("contact_margin", f"geom:{x}_geom") for x in ("foot", "leg")]
    model = nominal.model(nominal.start)
    published = (3.53429174, 3.92699082, 2.71433605, 5.0893801)
    for estimate, mass in zip(causes["body_mass", "body:*"].strengths, published, strict=True):
        body = estimate.name.split()[0]
        assert model.body(body).mass[0] + estimate.value == pytest.approx(mass, rel=1e-5)
    for geom in ("foot", "leg"):  # the floor's 0.001 and its own add up
        margin = causes["contact_margin", f"geom:{geom}_geom"].strengths[0].value
        assert margin == pytest.approx(-0.001, rel=1e-3)
    assert criticism.extension is not None
    before, after = (
        squared_error(each, dropo.read(folder)) for each in (nominal, criticism.extension.nominal())
    )
    assert before > 1e-3
    assert after < 1e-12


def squared_error(nominal, data):
    """Mean squared one-step error over observed columns, summed."""
    with Simulator(nominal, data) as simulator:
        predicted = simulator.predict(nominal.start, (), simulator.measured)
        error = (predicted - simulator.measured[simulator.starts + 1])[:, 1:]
    return float((error**2).sum(axis=1).mean())


def test_a_folder_without_a_record_is_refused(tmp_path):
    with pytest.raises(InvalidInput, match="has no record hoppermass_n10000"):
        dropo.read(tmp_path)
