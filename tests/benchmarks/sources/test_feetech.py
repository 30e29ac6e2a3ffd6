"""The Feetech servo: its logs, and a model that rests at its goal."""

import json

import mujoco
import numpy as np
import pytest

from adr_service.errors import InvalidInput
from benchmarks.sources import feetech


def log(path, mass=1.13, is_on=True):
    times = np.arange(0.0, 6.0, 0.02)
    entries = [
        {
            "timestamp": t,
            "position": 0.5 * np.sin(t),
            "goal_position": 0.5 * np.sin(t + 0.1),
            "torque_enable": is_on or t < 3,
        }
        for t in times.tolist()
    ]
    path.write_text(json.dumps({"mass": mass, "length": 0.12, "entries": entries}))
    return path


def test_logs_whose_torque_stays_on_are_read(tmp_path):
    logs = [log(tmp_path / "on.json"), log(tmp_path / "off.json", is_on=False)]
    data = feetech.read(logs)
    assert data.period() == pytest.approx(0.02)
    assert len(data.spans()) == 10  # of one log
    assert not data.is_measured()[1]  # the velocity


@pytest.mark.parametrize("stiffness", [10.0, 40.0])
def test_without_gravity_the_servo_rests_at_its_goal(stiffness):
    nominal = feetech.nominal()
    values = nominal.start.copy()
    values[2:] = stiffness
    model = nominal.model(values)
    model.opt.gravity[:] = 0.0
    data = mujoco.MjData(model)
    data.ctrl[:] = 0.7
    mujoco.mj_step(model, data, nstep=20_000)
    assert data.qpos[0] == pytest.approx(0.7, abs=1e-6)


def test_another_load_and_another_file_are_refused(tmp_path):
    with pytest.raises(InvalidInput, match=r"swings 2.0 kg at 0.12 m; expected are 1.13 kg"):
        feetech.read([log(tmp_path / "log.json", mass=2.0)])
    (tmp_path / "other.json").write_text("[]")
    with pytest.raises(InvalidInput, match="is no log of a servo"):
        feetech.read([tmp_path / "other.json"])
