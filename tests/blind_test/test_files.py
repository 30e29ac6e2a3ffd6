"""The files of a blind test: what is written is read, and what is wrong is refused."""

import json
from dataclasses import replace

import numpy as np
import pytest

from adr_service.blind_test.files import (
    QUESTION,
    Answer,
    Estimate,
    Key,
    Named,
    make_cases,
    read_answers,
    read_key,
    read_question,
    write_answer,
    write_question,
)
from adr_service.criticism.nominal import Nominal
from adr_service.effects.catalogue import get_mechanism
from adr_service.errors import InvalidInput, UnknownName
from adr_service.tasks.catalogue import get_task, source_of
from tests.blind_test.conftest import hidden

KEY = Key(seed=1, cases={"0000": hidden(), "0001": hidden("none", 0.0, ())})
NAMED = {"kind": "joint_spring", "location": "joint:elbow", "parameters": {}}


def with_strength(name, **bounds):
    return {**NAMED, "parameters": {name: {"value": 0.2, **bounds}}}


@pytest.fixture
def answered(tmp_path):
    """Write one answer as JSON, and read all of the folder."""

    def answer(value, name="0000"):
        (tmp_path / name).mkdir()
        (tmp_path / name / "verdict.json").write_text(json.dumps(value))
        return read_answers(tmp_path, KEY)

    return answer


def test_a_question_has_the_simulator_and_the_measurement_as_they_were(tmp_path, case):
    write_question(tmp_path, case)
    question = read_question(tmp_path)
    np.testing.assert_array_equal(question.measurement.qvel, case.measurement.qvel)
    np.testing.assert_allclose(question.nominal.start, case.nominal.start, rtol=1e-12)
    ours, theirs = (each.model(case.nominal.start) for each in (question.nominal, case.nominal))
    np.testing.assert_allclose(ours.body_inertia, theirs.body_inertia, rtol=1e-12)
    np.testing.assert_array_equal(ours.dof_damping, theirs.dof_damping)


def test_a_question_hides_its_answer_among_the_candidates(tmp_path, case):
    write_question(tmp_path, case)
    assert sorted(path.name for path in tmp_path.iterdir()) == sorted(QUESTION)
    candidates = [(e.kind, e.location) for e in read_question(tmp_path).candidates]
    assert (case.effects[0].kind, case.effects[0].location) in candidates
    assert len(candidates) > 50
    text = (tmp_path / "case.json").read_text() + (tmp_path / "model.xml").read_text()
    assert str(case.effects[0].values[0]) not in text


def test_candidates_have_the_units_of_their_places(tmp_path, case):
    """A hopper's root slides, and the columns of its sensors are positions and velocities."""
    hopper = Nominal.of_task(get_task("hopper"), source_of("hopper", "vanilla"))
    write_question(tmp_path, replace(case, nominal=hopper))
    known = json.loads((tmp_path / "case.json").read_text())["candidates"]
    units = {(c["kind"], c["location"]): c["strengths"] for c in known}
    assert units["joint_coulomb_friction", "joint:rootx"] == {"friction": "N"}
    assert units["joint_coulomb_friction", "joint:leg_joint"] == {"friction": "N m"}
    assert units["sensor_bias", "sensor:rootz.velocity"] == {"bias": "m/s"}
    assert units["sensor_bias", "sensor:leg_joint.position"] == {"bias": "rad"}


def test_candidates_are_effects_of_the_model(tmp_path, case):
    write_question(tmp_path, case)
    question = read_question(tmp_path)
    model = question.nominal.model(question.nominal.start)
    for each in question.candidates:
        mechanism = get_mechanism(each.kind)
        assert each.location in mechanism.locations(model)
        assert len(each.values) == len(mechanism.strengths)


def test_cases_and_key_are_the_same_for_the_same_seed(tmp_path):
    for name in ("one", "other"):
        make_cases(tmp_path / name, tmp_path / f"{name}.json", ["arm"], 2, seed=7)
    assert read_key(tmp_path / "one.json") == read_key(tmp_path / "other.json")
    for case in ("0000", "0001"):
        one, other = (tmp_path / name / case / "measured.npz" for name in ("one", "other"))
        assert one.read_bytes() == other.read_bytes()


def test_an_answer_is_read_as_it_was_written(tmp_path):
    estimate = Estimate(value=1.0, low=None, high=2.0)
    named = Named(kind="joint_spring", location="joint:elbow", parameters={"stiffness": estimate})
    answer = Answer(verdict="cause", causes=(named,), cpu_seconds=1.5)
    write_answer(tmp_path / "0000", answer)
    (read,) = read_answers(tmp_path, KEY).values()
    assert read == answer
    assert read.causes[0].parameters["stiffness"].has_interval


def test_an_answer_needs_a_verdict_alone(answered):
    answer = answered({"verdict": "none"})["0000"]
    assert (answer.verdict, answer.groups(), answer.cpu_seconds) == ("none", [], None)


@pytest.mark.parametrize(
    ("value", "message"),
    [
        ({}, "verdict: Field required"),
        ({"verdict": "maybe"}, "'cause', 'tie', 'none' or 'unknown'"),
        ({"verdict": "cause"}, "the verdict is cause, but causes is empty"),
        ({"verdict": "cause", "causes": [{"kind": "joint_spring"}]}, "location: Field required"),
        (
            {"verdict": "tie", "causes": [NAMED], "tied": [[], []]},
            "tied has 2 lists for 1 causes; expected is one for each, or none at all",
        ),
        ({"verdict": "none", "cpu_seconds": "3"}, "cpu_seconds: Input should be a valid number"),
        ({"verdict": "tie", "causes": [NAMED]}, "the verdict is tie, but nothing is tied"),
        (
            {"verdict": "cause", "causes": [NAMED], "tied": [[NAMED]]},
            "the verdict is cause, but tied names others",
        ),
        (
            {"verdict": "cause", "causes": [with_strength("stiffness", low=0.3, high=0.1)]},
            "the value 0.2 is not between low and high; given 0.3 to 0.1",
        ),
        (
            {"verdict": "cause", "causes": [with_strength("stiffness", high=0.3)]},
            "give both low and high (null where there is no bound), or neither",
        ),
        ({"verdict": "none", "causes": [NAMED]}, "the verdict is none, but something is named"),
        ({"verdict": "none", "residual": {"rest": "unknown"}}, "but something is named or left"),
    ],
)
def test_a_wrong_answer_is_refused_with_its_file_and_reason(answered, value, message):
    with pytest.raises(InvalidInput, match=r"0000/verdict\.json: ") as raised:
        answered(value)
    assert message in str(raised.value)


def test_a_misspelt_strength_is_refused_with_the_nearest_one(answered):
    cause = with_strength("stifness")
    with pytest.raises(UnknownName, match="did you mean 'stiffness'"):
        answered({"verdict": "cause", "causes": [cause]})


def test_a_misspelt_effect_is_refused_with_the_nearest_one(answered):
    cause = {**NAMED, "location": "joint:elbw"}
    with pytest.raises(UnknownName, match="did you mean 'joint_spring joint:elbow'"):
        answered({"verdict": "cause", "causes": [cause]})


def test_an_answer_to_a_case_that_the_key_lacks_is_refused(answered):
    with pytest.raises(InvalidInput, match="answers 0007, which the key does not have"):
        answered({"verdict": "none"}, name="0007")


def test_a_folder_without_answers_is_refused(tmp_path):
    with pytest.raises(InvalidInput, match="has no answers; expected are files as 0000/verdict"):
        read_answers(tmp_path, KEY)
    with pytest.raises(InvalidInput, match="is no folder of answers"):
        read_answers(tmp_path / "nowhere", KEY)


@pytest.mark.parametrize("name", QUESTION)
def test_a_question_that_lacks_a_file_is_refused_with_its_name(tmp_path, case, name):
    write_question(tmp_path, case)
    (tmp_path / name).unlink()
    with pytest.raises(InvalidInput, match=f"{name} cannot be read"):
        read_question(tmp_path)
    (tmp_path / name).write_bytes(b"nonsense")
    with pytest.raises(InvalidInput, match=str(tmp_path)):
        read_question(tmp_path)


def test_an_answer_that_names_groups_is_a_tie_where_one_of_them_has_two():
    spring, hardening = (Named(kind=kind, location="joint:elbow") for kind in ("spring", "cubic"))
    assert Answer.naming([], "none").verdict == "none"
    assert Answer.naming([[spring]], "unknown").verdict == "cause"
    tied = Answer.naming([[spring, hardening]], "none")
    assert tied.verdict == "tie"
    assert (tied.causes, tied.tied) == ((spring,), ((hardening,),))
