"""Figures of a criticism."""

from dataclasses import replace
from xml.etree import ElementTree

import pytest

from adr_service.criticism.figures import draw_all

SVG = "{http://www.w3.org/2000/svg}"


@pytest.fixture(scope="module")
def figures(criticism):
    return draw_all(criticism)


def test_a_cause_has_all_figures(figures):
    assert list(figures) == ["where", "ranking", "residual", "horizons", "trace"]


def test_a_criticism_without_a_gain_has_no_figures_of_causes(criticism, figures):
    without = replace(criticism, verdict=replace(criticism.verdict, gain=None))
    assert draw_all(without) == {name: figures[name] for name in ("where", "ranking")}


def test_the_same_criticism_gives_the_same_bytes(criticism, figures):
    assert draw_all(criticism) == figures


def test_every_figure_is_an_svg_with_finite_coordinates(figures):
    for svg in figures.values():
        root = ElementTree.fromstring(svg)  # noqa: S314 - our own text
        assert root.tag == SVG + "svg"
        drawn = [path.get("d") for path in root.iter(SVG + "path")]
        assert drawn
        assert not any("nan" in path or "inf" in path for path in drawn)


def test_labels_are_text_that_names_joints_and_candidates(criticism, figures):
    texts = {
        name: [text.text for text in ElementTree.fromstring(svg).iter(SVG + "text")]  # noqa: S314
        for name, svg in figures.items()
    }
    assert {"shoulder", "elbow", "velocity", "contact"} <= set(texts["where"])
    best = criticism.candidates[0]
    assert f"{best.kind}, {best.location}" in texts["ranking"]
    assert {"as it is", "extended"} <= set(texts["horizons"])
    assert {"measured", "as it is", "extended"} <= set(texts["trace"])
