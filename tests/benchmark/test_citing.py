"""Papers to cite for what was run, and no others."""

import re

import pytest

from adr_service.benchmark.citing import bibtex, papers_of
from adr_service.citations import Paper
from adr_service.methods.catalogue import methods
from adr_service.specs import CriticismSpec, RunSpec


def keys(*methods, **others):
    given = {"task": "arm", "preset": "smoke", **others}
    specs = [RunSpec.model_validate({**given, "method": method}) for method in methods]
    return [paper.key for paper in papers_of(specs)]


def test_a_run_cites_the_benchmark_its_method_its_algorithm_and_the_software():
    assert keys("bayrn") == [
        "tiboni2022benchmark",
        "muratore2021bayrn",
        "haarnoja2018sac",
        "raffin2021stable",
        "todorov2012mujoco",
    ]


def test_an_offline_method_cites_whose_trajectories_it_learns_from():
    assert "chebotar2019simopt" in keys("dropo")
    assert "chebotar2019simopt" not in keys("dropo", collector="random")


def test_an_extension_cites_the_paper_it_extends_and_each_paper_stands_once():
    several = keys("dropo", "e_dropo", "dropo_smoothed", "prior")
    assert {"tiboni2023dropo", "fickinger2025provable"} <= set(several)
    assert len(several) == len(set(several))


def test_a_criticism_cites_the_simulator_alone():
    spec = CriticismSpec(task="arm", dataset="data_1")
    assert [paper.key for paper in papers_of([spec])] == ["todorov2012mujoco"]


def test_an_entry_is_bibtex():
    paper = Paper("a2020b", "On {Walker2d}", "Ada, A. and Bo, B.", 2020, arxiv="2001.00001")
    assert bibtex([paper, paper]).split("\n\n")[0] == (
        "@misc{a2020b,\n  title = {{On {Walker2d}}},\n  author = {Ada, A. and Bo, B.},\n"
        "  year = {2020},\n  eprint = {2001.00001},\n  archiveprefix = {arXiv}\n}"
    )


@pytest.mark.parametrize("name", methods())
def test_every_paper_of_ours_is_complete(name):
    for paper in methods()[name].papers:
        assert re.fullmatch(r"[a-z]+\d{4}[a-z]+", paper.key)
        assert str(paper.year) in paper.key
        assert paper.title
        assert paper.authors
        assert re.fullmatch(r"(\d{4}\.\d{5})?", paper.arxiv)
        assert paper.bibtex().count("{") == paper.bibtex().count("}")


@pytest.mark.parametrize(
    ("where", "kind", "line"),
    [
        ({"journal": "J"}, "article", "journal = {J}"),
        ({"conference": "C"}, "inproceedings", "booktitle = {C}"),
        ({}, "misc", None),
    ],
)
def test_the_kind_of_an_entry_is_that_of_its_place(where, kind, line):
    entry = Paper("a2020b", "A title", "Ada, A.", 2020, **where).bibtex()
    assert entry.startswith(f"@{kind}{{a2020b,")
    assert line is None or line in entry
