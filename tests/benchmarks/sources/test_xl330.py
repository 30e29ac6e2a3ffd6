"""XL-330: a servo's free swings, criticised."""

import json

import numpy as np
import pytest

from adr_service.criticism.pipeline import criticise
from adr_service.errors import InvalidInput
from benchmarks.sources import xl330


@pytest.mark.slow
def test_the_servos_coulomb_friction_and_its_encoders_offset_are_named(datasets):
    """Published checks (2 of 4 swings): Coulomb .0138 N m, offset .0295 rad, and of a later fit
    armature .0018 kg m²."""
    logs = sorted((datasets / "bam_xl330" / "raw").glob("*.json"))
    drops = [p for p in logs if json.loads(p.read_text())["trajectory"] == "lift_and_drop"]
    criticism = criticise(xl330.nominal(), xl330.read(drops), np.random.default_rng(0))
    offset, friction = criticism.verdict.causes
    alike = {c.kind: c.strengths[0].value for c in (offset, *criticism.verdict.tied[0])}
    assert {"sensor_bias", "joint_reference_offset"} <= set(alike)
    assert alike["sensor_bias"] == pytest.approx(-0.0295, rel=0.1)
    assert friction.kind == "joint_coulomb_friction"
    assert friction.strengths[0].value == pytest.approx(0.0138, rel=0.1)
    assert criticism.verdict.gain is not None
    for steps in (5, 25):
        without, with_causes = criticism.verdict.gain.horizons[steps]
        assert with_causes < 0.5 * without


def test_a_file_that_is_no_log_of_a_servo_is_refused(tmp_path):
    log = tmp_path / "log.json"
    log.write_text('{"entries": [{"timestamp": 0}]}')
    with pytest.raises(InvalidInput, match="is no log of a servo"):
        xl330.read([log])
    entries = [{"timestamp": 0.01 * k, "position": 0.0, "torque_enable": True} for k in range(9)]
    log.write_text(json.dumps({"entries": entries}))
    with pytest.raises(InvalidInput, match="never switches the torque off"):
        xl330.read([log])
