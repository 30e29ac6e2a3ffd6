"""Steps of a sensor, and noise beyond what the measurement states."""

import io

import numpy as np
import pytest
from rich.console import Console

from adr_service.criticism.measurements import Measurement
from adr_service.criticism.pipeline import criticise
from adr_service.criticism.sensor_spread import lattice
from api.cli.verdict_table import verdict_table
from tests.hidden import arm


def criticised(fields):
    return criticise(arm()[1], Measurement(**fields), np.random.default_rng(0), threads=1)


def test_steps_are_seen_where_they_matter(clean):
    qpos = clean["qpos"].copy()
    qpos[:, 1] = 0.005 * np.round(qpos[:, 1] / 0.005)
    found = criticised({**clean, "qpos": qpos})
    (cause,) = found.verdict.causes
    assert (cause.kind, cause.location) == ("sensor_quantisation", "sensor:elbow.position")
    assert cause.strengths[0].value == pytest.approx(0.005, rel=1e-9)
    assert (found.verdict.conclusion, found.verdict.gain) == ("cause", None)
    assert [c.kind for c in found.extension.beside] == ["sensor_quantisation"]
    console = Console(width=200, record=True, file=io.StringIO())
    console.print(verdict_table(found.verdict.to_json()))
    assert "sensor_quantisation" in console.export_text()


def test_more_noise_than_was_stated_is_seen(clean):
    """The elbow's velocity is stated to have half of the noise that it has."""
    stated = {"qpos_std": np.full(2, 1e-3), "qvel_std": np.array([0.01, 0.005])}
    (cause,) = criticised({**clean, **stated}).verdict.causes
    assert (cause.kind, cause.location) == ("sensor_noise", "sensor:elbow.velocity")
    assert cause.strengths[0].low < np.sqrt(0.01**2 - 0.005**2) < cause.strengths[0].high


@pytest.mark.slow
def test_the_last_digits_of_a_file_are_no_steps(clean):
    rounded = {**clean, "qpos": np.round(clean["qpos"], 4)}
    assert criticised(rounded).verdict.conclusion == "none"


def test_a_lattice_is_measured_to_the_last_digits():
    readings = 0.3 + 2 * np.pi / 4096 * np.random.default_rng(0).integers(-50, 50, 2000)
    assert lattice(readings) == pytest.approx(2 * np.pi / 4096, rel=1e-12)
    assert lattice(np.random.default_rng(0).standard_normal(2000)) is None
    assert lattice(np.repeat([0.0, 2.0, 5.0, 7.0, 9.0, 12.0], 9)) == 1.0
    odd = np.append(readings, 0.30001 + readings[:1000])  # two lattices are none
    assert lattice(odd) is None
    digits = np.round(np.random.default_rng(0).standard_normal(90_000), 4)
    assert lattice(digits) is None  # the last ones of a file
