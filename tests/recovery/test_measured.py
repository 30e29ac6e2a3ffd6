"""Recordings of others, criticised: a servo's free swings, and an older engine's Hopper."""

import json

import numpy as np
import pytest

from adr_service.criticism.pipeline import criticise
from adr_service.criticism.simulator import Simulator
from adr_service.errors import InvalidInput
from benchmarks.sources import dropo, xl330


@pytest.mark.slow
def test_the_servos_coulomb_friction_and_its_encoders_offset_are_found(datasets):
    """Published checks (2 of 4 swings): Coulomb .0138 N m, offset .0295 rad, and of a later fit
    armature .0018 kg m²."""
    logs = sorted((datasets / "bam_xl330" / "raw").glob("*.json"))
    drops = [p for p in logs if json.loads(p.read_text())["trajectory"] == "lift_and_drop"]
    found = criticise(xl330.nominal(), xl330.read(drops), np.random.default_rng(0))
    offset, friction = found.verdict.causes
    alike = {c.kind: c.strengths[0].value for c in (offset, *found.verdict.tied[0])}
    assert {"sensor_bias", "joint_reference_offset"} <= set(alike)
    assert alike["sensor_bias"] == pytest.approx(-0.0295, rel=0.1)
    assert friction.kind == "joint_coulomb_friction"
    assert friction.strengths[0].value == pytest.approx(0.0138, rel=0.1)
    assert found.verdict.gain is not None
    for steps in (5, 25):
        without, with_causes = found.verdict.gain.horizons[steps]
        assert with_causes < 0.5 * without


@pytest.mark.slow
def test_what_today_s_hopper_gets_wrong_of_an_older_engine_is_found(datasets):
    """Inertias and masses of all bodies, and the contact margin (MuJoCo 2.1 against 4.0).

    Learned from 6 of 20 episodes; the error is of all of them. The masses are published.
    """
    folder = datasets / "dropo_hopper" / "hopper10000"
    nominal = dropo.nominal()
    found = criticise(nominal, dropo.read(folder, episodes=6), np.random.default_rng(0))
    causes = {(c.kind, c.location): c for c in found.verdict.causes}
    assert set(list(causes)[:2]) == {("body_inertia", "body:*"), ("body_mass", "body:*")}
    assert list(causes)[2:] == [("contact_margin", f"geom:{x}_geom") for x in ("foot", "leg")]
    model = nominal.model(nominal.start)
    published = (3.53429174, 3.92699082, 2.71433605, 5.0893801)
    for estimate, mass in zip(causes["body_mass", "body:*"].strengths, published, strict=True):
        body = estimate.name.split()[0]
        assert model.body(body).mass[0] + estimate.value == pytest.approx(mass, rel=1e-5)
    margin = causes["contact_margin", "geom:foot_geom"].strengths[0].value
    assert margin == pytest.approx(-0.001, rel=1e-3)  # 0.001 of the floor and of the foot add up
    assert found.extension is not None
    before, after = (
        squared_error(each, dropo.read(folder)) for each in (nominal, found.extension.nominal())
    )
    assert before > 1e-3
    assert after < 1e-6


def squared_error(nominal, data):
    """Mean squared one-step error over observed columns, summed."""
    with Simulator(nominal, data) as simulator:
        predicted = simulator.predict(nominal.start, (), simulator.measured)
        error = (predicted - simulator.measured[simulator.starts + 1])[:, 1:]
    return float((error**2).sum(axis=1).mean())


def test_what_is_no_log_of_a_servo_is_refused(tmp_path):
    log = tmp_path / "log.json"
    log.write_text('{"entries": [{"timestamp": 0}]}')
    with pytest.raises(InvalidInput, match="is no log of a servo"):
        xl330.read([log])
    entries = [{"timestamp": 0.01 * k, "position": 0.0, "torque_enable": True} for k in range(9)]
    log.write_text(json.dumps({"entries": entries}))
    with pytest.raises(InvalidInput, match="never switches the torque off"):
        xl330.read([log])


def test_what_is_no_record_of_dropos_is_refused(tmp_path):
    with pytest.raises(InvalidInput, match="has no record hoppermass_n10000"):
        dropo.read(tmp_path)
