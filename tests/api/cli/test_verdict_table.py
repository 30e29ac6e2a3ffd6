"""The verdict of a criticism on a terminal."""

import io

from rich.console import Console

from api.cli.verdict_table import verdict_table

STRENGTH = {"value": 1.0, "low": 0.5, "high": 1.5, "unit": "N m s/rad"}
CAUSE = {
    "kind": "joint_asymmetric_viscous_friction",
    "location": "joint:foot_left_joint",
    "parameters": {"friction": STRENGTH},
    "gain_nats": 30.0,
}
OTHER = {**CAUSE, "kind": "joint_damping"}
VERDICT = {
    "verdict": "cause",
    "confidence": 0.99,
    "causes": [CAUSE],
    "tied": [[]],
    "residual": {"rest": "none", "parameters": {}},
    "gain": None,
    "remarks": [],
}


def shown(verdict, width=80):
    console = Console(file=(output := io.StringIO()), width=width, markup=False)
    console.print(verdict_table(verdict))
    return output.getvalue()


def test_names_of_causes_are_not_wrapped_on_narrow_terminals():
    assert f"{CAUSE['kind']}  {CAUSE['location']}" in shown(VERDICT)


def test_a_tie_names_both_causes():
    text = shown({**VERDICT, "tied": [[OTHER]]}, 200)
    assert f"or {OTHER['kind']}" in text


def test_a_parameter_at_its_bound_is_a_warning():
    residual = {"rest": "unknown", "parameters": {"mass": {"at_bound": True}}}
    text = shown({**VERDICT, "residual": residual}, 200)
    assert "mass is at the edge of its bounds" in text
    assert "something else is missing" in text


def test_what_is_left_is_shown_with_its_place():
    where = {"location": "joint:knee", "depends_on": "frequency", "hertz": 2.72}
    residual = {"rest": "unknown", "parameters": {}, "where": where}
    verdict = {**VERDICT, "verdict": "unknown", "causes": [], "tied": [], "residual": residual}
    text = shown(verdict, 200)
    assert "a force at joint:knee that depends on time, at 2.72 Hz: look for something" in text


def test_the_gain_is_shown_with_its_interval_and_time_step():
    gain = {"low": 0.5, "sse_removed": 0.6, "high": 0.7}
    step = {"judged_with": 0.001, "of_the_model": 0.002}
    residual = {**VERDICT["residual"], "timestep": step}
    text = shown({**VERDICT, "gain": gain, "residual": residual}, 200)
    assert "60.0 % [50.0, 70.0]" in text
    assert "judged in steps of 1 ms, because the model's steps of 2 ms make larger errors" in text
    assert "take 2 smaller steps for each of them" in text


def test_an_unbounded_interval_is_shown_as_such():
    cause = {**CAUSE, "parameters": {"friction": {**STRENGTH, "low": None}}}
    assert "-∞ to 1.5" in shown({**VERDICT, "causes": [cause]}, 200)
    cause = {**CAUSE, "parameters": {"friction": {**STRENGTH, "high": None}}}
    assert "not determined" in shown({**VERDICT, "causes": [cause]}, 200)


def test_without_a_cause_there_is_no_table():
    text = shown({**VERDICT, "verdict": "none", "causes": [], "tied": []})
    assert text.startswith("none, ")
    assert "location" not in text
