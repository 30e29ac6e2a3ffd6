"""The DFKI pendulums: models by the authors' identification, and logs in their format."""

import numpy as np
import pytest

from benchmarks.sources import pendulums
from benchmarks.sources.pendulums import COMMANDED, ONE, SINGLE, A, nominal, read


@pytest.mark.parametrize("links", [A, pendulums.C, ONE])
def test_a_model_has_the_identified_inertias_and_neither_friction_nor_rotors(links):
    model = nominal(links).model(nominal(links).start)
    assert not model.dof_armature.any()
    assert not model.dof_damping.any()
    for number, link in enumerate(links, start=1):
        body = model.body(f"link{number}")
        about_joint = body.inertia[1] + body.mass[0] * body.ipos[2] ** 2
        assert about_joint == pytest.approx(link.inertia)


def test_logs_become_rows_of_ten_milliseconds_in_episodes_of_a_second(tmp_path):
    time = np.arange(0.0, 9.0, 0.002)
    names = ["time", *(f"{n}{joint}" for joint in (1, 2) for n in ("pos_meas", "vel_meas"))]
    columns = [time, np.sin(time), np.cos(time), np.sin(2 * time), 2 * np.cos(2 * time)]
    names += ["tau_con1", "tau_con2"]
    columns += [0.3 * np.sin(3 * time), 0.2 * np.cos(time)]
    log = tmp_path / "log.csv"
    np.savetxt(log, np.column_stack(columns), delimiter=",", header=",".join(names), comments="")
    data = read([log], A, COMMANDED)
    assert data.period() == pytest.approx(0.01)
    assert {last - first for first, last in data.spans()} == {100}
    rows = [first for first, _ in data.spans()]
    np.testing.assert_allclose(data.qpos[rows, 1], np.sin(2 * data.time[rows]), atol=1e-6)


def test_a_log_of_one_joint_has_no_numbers_in_its_columns(tmp_path):
    time = np.arange(0.0, 10.0, 0.005)
    columns = [time, np.sin(time), np.cos(time), 0.1 * np.cos(2 * time)]
    log = tmp_path / "log.csv"
    header = "time,position,velocity,torque"
    np.savetxt(log, np.column_stack(columns), delimiter=",", header=header, comments="")
    assert read([log], ONE, SINGLE).period() == pytest.approx(0.005)
