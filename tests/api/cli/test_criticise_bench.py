"""`adr criticise-bench`: cases for others, and their scores."""

import json

import pytest

from adr_service.blind_test import planting
from adr_service.blind_test.files import read_key


@pytest.fixture
def made(adr_here, tmp_path, monkeypatch):
    """Two cases of the arm in the working directory, and their key."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(planting, "EPISODES", 8)
    where = ["--out", "cases", "--key", "key.json"]
    status, shown, errors = adr_here(
        "criticise-bench", "make", *where, "--cases", "2", "--seed", "9"
    )
    assert status == 0, errors
    assert shown == "cases: 2 cases; key.json: what they hide\n"
    return tmp_path


def test_answers_of_two_methods_are_scored_side_by_side(adr_here, made):
    key = read_key(made / "key.json")
    for name, hidden in key.cases.items():
        right = [{"kind": e.kind, "location": e.location} for e in hidden.effects]
        verdict = "cause" if right else "unknown" if hidden.outside else "none"
        for method, answer in (
            ("right", {"verdict": verdict, "causes": right}),
            ("never_sure", {"verdict": "unknown"}),
        ):
            (made / method / name).mkdir(parents=True)
            (made / method / name / "verdict.json").write_text(json.dumps(answer))
    score = ["criticise-bench", "score", "right", "never_sure", "--key", "key.json"]
    status, shown, _ = adr_here(*score)
    assert status == 0
    assert "never_sure" in shown
    _, shown, _ = adr_here(*score, "--json")
    scores = json.loads(shown)
    name = "in the catalogue, or nothing: not unknown"
    known = sum(hidden.outside is None for hidden in key.cases.values())
    assert scores["right"][name].startswith(f"{known} of {known} ")
    assert scores["never_sure"][name].startswith(f"0 of {known} ")


def test_cases_overwrite_nothing(adr_here, made):
    where = ["--out", "others", "--key", "key.json", "--seed", "9"]
    status, _, errors = adr_here("criticise-bench", "make", *where)
    assert status == 2
    assert "key.json is there already; give another name" in errors
    assert not (made / "others").exists()


def test_an_unknown_robot_is_refused_before_anything_is_written(adr_here, tmp_path):
    where = ["--out", str(tmp_path / "cases"), "--key", str(tmp_path / "key.json")]
    status, _, errors = adr_here(
        "criticise-bench", "make", *where, "--seed", "9", "--tasks", "arm,hoper"
    )
    assert status == 2
    assert "did you mean 'hopper'?" in errors
    assert list(tmp_path.iterdir()) == []


def test_a_key_among_the_cases_is_refused(adr_here, tmp_path):
    where = ["--out", str(tmp_path / "cases"), "--key", str(tmp_path / "cases/key.json")]
    status, _, errors = adr_here("criticise-bench", "make", *where, "--seed", "9")
    assert status == 2
    assert "would lie among the cases" in errors


def test_criticism_answers_what_has_no_answer_yet(adr_here, made):
    (made / "ours/0000").mkdir(parents=True)
    (made / "ours/0000/verdict.json").write_text(json.dumps({"verdict": "unknown"}))
    status, shown, errors = adr_here("criticise-bench", "answer", "cases", "--out", "ours")
    assert status == 0, errors
    assert shown.startswith("0001: ")
    assert shown.count("\n") == 1
    assert json.loads((made / "ours/0000/verdict.json").read_text()) == {"verdict": "unknown"}
    assert json.loads((made / "ours/0001/verdict.json").read_text())["cpu_seconds"] > 0


def test_a_folder_without_cases_is_refused(adr_here, tmp_path):
    status, _, errors = adr_here("criticise-bench", "answer", str(tmp_path), "--out", "ours")
    assert status == 2
    assert "has no cases; expected are files as 0000/case.json" in errors
