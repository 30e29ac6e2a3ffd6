"""Specs from files, and from settings as text."""

import json

import pytest

from adr_service.errors import InvalidInput
from api.specs import assign, named_values, read_effects, read_spec


@pytest.mark.parametrize(
    ("assignment", "spec"),
    [
        ("seed=3", {"method": "dropo", "seed": 3}),
        ("preset=smoke", {"method": "dropo", "preset": "smoke"}),
        ("training.max_steps=1000", {"method": "dropo", "training": {"max_steps": 1000}}),
        ("method.samples=10", {"method": {"name": "dropo", "samples": 10}}),
        ("note=a=b", {"method": "dropo", "note": "a=b"}),
        ("seeds=[1, 2]", {"method": "dropo", "seeds": [1, 2]}),
        ("target=null", {"method": "dropo", "target": None}),
    ],
)
def test_an_assignment_sets_one_field(assignment, spec):
    given = {"method": "dropo"}
    assign(given, [assignment])
    assert given == spec


def test_a_path_into_a_list_is_refused():
    """It was refused by the service for an object that nobody had given."""
    given = {"methods": [{"name": "simopt"}, "dropo"]}
    refusal = r'methods.0.samples cannot be set: methods is \[{"name": "simopt"}, "dropo"\]; set it'
    with pytest.raises(InvalidInput, match=refusal):
        assign(given, ["methods.0.samples=3"])
    with pytest.raises(
        InvalidInput, match=r"training.gamma.x cannot be set: training.gamma is 0.9"
    ):
        assign({"training": {"gamma": 0.9}}, ["training.gamma.x=1"])
    assign(spec := {"target": None}, ["target.kind=external"])
    assert spec == {"target": {"kind": "external"}}


def test_a_named_value_may_have_dots_in_its_name():
    values = named_values(["thigh.mass=3.9", "damping=[1]"])
    assert values == {"thigh.mass": 3.9, "damping": [1]}
    with pytest.raises(InvalidInput, match=r"thigh.mass is given already, and 'thigh.mass=4'"):
        named_values(["thigh.mass=3.9", "thigh.mass=4"])
    with pytest.raises(InvalidInput, match="a setting is name=value"):
        named_values(["thigh.mass"])


def test_a_value_nested_without_end_is_a_text():
    spec = {}
    assign(spec, ["x=" + "[" * 100_000])
    assert spec["x"].startswith("[[")


def test_assignments_leave_other_fields_as_they_are():
    spec = {"training": {"gamma": 0.9}}
    assign(spec, ["training.max_steps=1", "training.gamma=0.8"])
    assert spec == {"training": {"gamma": 0.8, "max_steps": 1}}
    assign(spec, None)
    assert spec == {"training": {"gamma": 0.8, "max_steps": 1}}


def test_a_field_that_is_given_twice_is_refused():
    with pytest.raises(InvalidInput, match="iterations is given already, and 'iterations=3'"):
        assign({}, ["iterations=2", "iterations=3"])
    with pytest.raises(InvalidInput, match="task is given already, and 'task=arm' beside it"):
        assign({"task": "hopper"}, ["task=arm"], fixed=["task"])
    with pytest.raises(InvalidInput, match="training is given already"):
        assign({}, ["training.max_steps=10", 'training={"gamma":0.5}'])
    with pytest.raises(InvalidInput, match=r"training\.gamma is given already"):
        assign({}, ['training={"gamma":0.5}', "training.gamma=0.6"])
    assign(spec := {"target": {"kind": "recorded"}}, ["target.episodes=1"], fixed=["target"])
    assert spec == {"target": {"kind": "recorded", "episodes": 1}}


def test_an_assignment_without_a_value_is_refused():
    with pytest.raises(
        InvalidInput, match="a setting is name=value, as iterations=2; given 'seed'"
    ):
        assign({}, ["seed"])


def test_a_spec_file_holds_one_object(tmp_path):
    file = tmp_path / "spec.json"
    file.write_text('{"task": "arm"}')
    assert read_spec(file) == {"task": "arm"}
    file.write_bytes(b"\xef\xbb\xbf" + '{"note": "Ä"}'.encode())  # as Windows saves it
    assert read_spec(file) == {"note": "Ä"}
    file.write_text("[]")
    with pytest.raises(InvalidInput, match="must hold one JSON object; given list"):
        read_spec(file)
    for content in ("task: arm", "[" * 100_000):
        file.write_text(content)
        with pytest.raises(InvalidInput, match="not a readable JSON file"):
            read_spec(file)


def test_effects_are_read_without_their_mjcf(tmp_path):
    file = tmp_path / "effects.json"
    effect = {"kind": "joint_damping", "location": "joint:elbow", "values": [0.1]}
    file.write_text(json.dumps({"version": 1, "effects": [{**effect, "in_mjcf": True}]}))
    assert read_effects(file) == [effect]


@pytest.mark.parametrize(
    "content", [{}, {"version": 2, "effects": []}, {"version": 1, "effects": ["a"]}], ids=str
)
def test_other_files_are_no_effects(tmp_path, content):
    file = tmp_path / "verdict.json"
    file.write_text(json.dumps(content))
    with pytest.raises(InvalidInput, match="no list of effects, version 1; give"):
        read_effects(file)
