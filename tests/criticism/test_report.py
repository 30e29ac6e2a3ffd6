"""Files of a criticism: the page, the verdict and the extended model."""

import json
from dataclasses import replace
from xml.etree import ElementTree

import pytest

import adr_service
from adr_service.criticism.experiments import Experiment
from adr_service.criticism.report import (
    FILES,
    _advice,
    _bounds,
    _finding,
    _in_mjcf,
    files_of,
    report_page,
)
from adr_service.criticism.verdict import Conclusion, Rest

ORIGIN = "measured <1>.npz, seed 7"


@pytest.fixture(scope="module")
def page(criticism):
    return report_page(criticism, "arm", ORIGIN)


def test_a_named_cause_has_all_files(criticism):
    files = files_of(criticism, "arm", ORIGIN)
    assert tuple(files) == FILES
    verdict = json.loads(files["verdict.json"])
    assert verdict["version"] == 1
    assert json.dumps(verdict, allow_nan=False)
    assert json.loads(files["effects.json"])["effects"][0]["kind"] in files["report.html"].decode()
    ElementTree.fromstring(files["extended.xml"])  # noqa: S314 - our own bytes


def test_the_same_criticism_gives_the_same_bytes(criticism):
    assert files_of(criticism, "arm", ORIGIN) == files_of(criticism, "arm", ORIGIN)


def test_the_page_says_that_free_parameters_have_other_values_in_the_extended_model(
    criticism, page
):
    names = ", ".join(criticism.final.simulator.nominal.space.names)
    assert f"Free parameters were fitted again beside these ({names})" in page
    assert "fitted again" not in _in_mjcf(criticism.extension, ())


def test_the_page_says_what_it_was_made_of(criticism, page):
    data = criticism.baseline.simulator.data
    assert "From measured &lt;1&gt;.npz, seed 7." in page
    assert f"Fitted to {criticism.verdict.residual.used} transitions" in page
    assert f"in {len(data.spans())} episodes" in page
    assert adr_service.__version__ in page


def test_a_name_on_the_page_is_escaped(criticism):
    page = report_page(criticism, "<script>alert(1)</script>", ORIGIN)
    assert "<script>" not in page
    assert "&lt;script&gt;" in page


def test_the_page_names_each_cause_with_its_interval(criticism, page):
    for cause in criticism.verdict.causes:
        assert cause.kind.replace("_", " ") in page
    for strength in criticism.verdict.causes[0].strengths:
        assert strength.interval in page


def test_free_parameters_have_their_units(criticism, page):
    free = page.split("<h2>The free parameters</h2>")[1].split("</table>")[0]
    for parameter in criticism.baseline.simulator.nominal.space.parameters:
        assert f"<td>{parameter.name}</td><td>{parameter.unit}</td>" in free


def test_the_page_lists_what_the_data_cannot_tell_apart(criticism):
    names = ("body_mass body:fore", "body_inertia body:fore")
    verdict = criticism.verdict
    for confused, is_listed in (((names,), True), ((), False)):
        residual = replace(verdict.residual, confused=confused)
        page = report_page(
            replace(criticism, verdict=replace(verdict, residual=residual)), "arm", ORIGIN
        )
        assert ("body_mass body:fore, or body_inertia body:fore" in page) == is_listed
        assert ("cannot tell apart" in page) == is_listed


def test_the_page_gives_the_share_of_what_is_not_noise_with_its_interval(criticism):
    gain = replace(
        criticism.verdict.gain, explainable_fraction=0.8, explainable_interval=(0.6, 0.9)
    )
    page = report_page(
        replace(criticism, verdict=replace(criticism.verdict, gain=gain)), "arm", ORIGIN
    )
    assert "80.0 % [60.0, 90.0] of what is neither noise nor left" in page


def test_the_page_says_where_something_unknown_is_left(criticism):
    where = Rest("joint:elbow", "frequency", 2.7)
    residual = replace(
        criticism.verdict.residual, rest="unknown", unexplained_nats=30.0, where=where
    )
    verdict = replace(criticism.verdict, conclusion=Conclusion.UNKNOWN, residual=residual)
    page = report_page(replace(criticism, verdict=verdict), "arm", ORIGIN)
    assert "a force at joint:elbow that depends on time, at 2.7 Hz predicts 30 nats better" in page
    assert "Look for something that swings by itself" in page


def test_only_a_page_with_causes_speaks_of_their_refined_evidence(criticism):
    nothing = replace(criticism.verdict, conclusion=Conclusion.NONE, causes=(), tied=())
    pages = (
        report_page(each, "arm", ORIGIN)
        for each in (criticism, replace(criticism, verdict=nothing, named=(), extension=None))
    )
    assert ["Diamonds" in page for page in pages] == [True, False]


def test_the_page_does_not_claim_that_data_cannot_show_what_was_not_tried(criticism, page):
    """Steps and noise of sensors have no detection limit, and joints' limits rule effects out."""
    assert "what is not listed was not tried, or cannot be seen in these data" in page
    kinds = {name.split()[0] for name in criticism.verdict.residual.detectable}
    assert "actuator_bias" in kinds
    assert kinds.isdisjoint({"sensor_noise", "sensor_quantisation"})


@pytest.mark.parametrize(
    ("apart", "recorded", "words"),
    [
        (5.0, 1.0, "differ by 5.0 times"),
        (5.0, 6.0, "further than whole episodes"),
        (1.0, 0.5, "in none of the experiments"),
    ],
)
def test_a_tie_has_the_experiment_that_would_separate_it(criticism, apart, recorded, words):
    cause, *_ = criticism.verdict.causes
    tie = replace(
        criticism.verdict,
        conclusion=Conclusion.TIE,
        causes=(cause,),
        tied=((replace(cause, kind="joint_spring"),),),
        experiments=((Experiment("push", apart, recorded),),),
        residual=replace(criticism.verdict.residual, at_bound=("mass",), rest="unknown"),
    )
    assert words in _advice(tie)
    assert "mass went to the edge" in _bounds(tie)
    assert "Other causes explain as much" in _finding(tie)
    assert "Something else is missing" in _finding(tie)
