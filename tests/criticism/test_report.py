"""Files of a criticism: the page, its figures, the verdict and the extended model."""

import json
from xml.etree import ElementTree

import numpy as np
import pytest

from adr_service.criticism.figures import draw_all
from adr_service.criticism.pipeline import criticise
from adr_service.criticism.report import FILES, files_of, report_page
from benchmarks.planted import draw_case
from tests.hidden import arm


@pytest.fixture(scope="module")
def criticism():
    case = draw_case(*arm(), np.random.default_rng(100), 0.3)
    return criticise(
        case.nominal, case.measurement.episodes(range(12)), np.random.default_rng(0), threads=1
    )


def test_a_named_cause_has_all_files(criticism):
    files = files_of(criticism, "arm")
    assert tuple(files) == FILES
    assert json.loads(files["verdict.json"])["version"] == 1
    assert json.loads(files["effects.json"])["effects"][0]["kind"] in files["report.html"].decode()
    ElementTree.fromstring(files["extended.xml"])  # noqa: S314 - our own bytes


def test_the_same_criticism_gives_the_same_bytes(criticism):
    assert files_of(criticism, "arm") == files_of(criticism, "arm")


def test_a_name_on_the_page_is_escaped(criticism):
    page = report_page(criticism, "<script>alert(1)</script>")
    assert "<script>" not in page
    assert "&lt;script&gt;" in page


def test_the_page_names_each_cause_and_its_alternatives(criticism):
    page = report_page(criticism, "arm")
    for cause, tied in zip(criticism.verdict.causes, criticism.verdict.tied, strict=True):
        for each in (cause, *tied):
            assert each.kind.replace("_", " ") in page
    for strength in criticism.verdict.causes[0].strengths:
        assert strength.interval in page


def test_figures_are_svg_and_those_of_causes_need_a_cause(criticism):
    figures = draw_all(criticism)
    assert list(figures) == ["where", "ranking", "residual", "horizons", "trace"]
    assert all("<svg" in svg for svg in figures.values())


def test_the_residual_counts_every_transition_once(criticism):
    residual = criticism.verdict.residual
    assert residual.used + residual.diverged == 9 * 75  # three of twelve episodes are sealed
    assert set(residual.moved) == set(criticism.baseline.simulator.nominal.space.names)


def test_the_gain_is_inside_its_interval(criticism):
    gain = criticism.verdict.gain
    assert gain.low < gain.sse_removed < gain.high <= 1
    assert set(gain.horizons) == {1, 5, 25}
