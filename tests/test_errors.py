"""Errors, and the reasons for which a run can fail."""

import re
from pathlib import Path

import pytest

from adr_service.errors import AdrError, BudgetExceeded, FailureCode, UnknownName, remedy_of

OPERATIONS = Path(__file__).parents[1] / "docs" / "operations.md"


def test_the_docs_list_every_failure_code_with_its_remedy():
    section = OPERATIONS.read_text().split("## When a run fails")[1].split("\n## ")[0]
    rows = re.findall(r"^\| `(\w+)` \| (.+) \| (.+) \|$", section, re.MULTILINE)
    assert rows == [(code.value, code.meaning, code.remedy) for code in FailureCode]


@pytest.mark.parametrize("code", FailureCode)
def test_a_failure_code_has_a_meaning_and_a_remedy_in_whole_sentences(code):
    for sentence in (code.meaning, code.remedy):
        assert re.fullmatch(r"[A-Z].{20,}\.", sentence)
    assert remedy_of(code.value) == code.remedy


def test_a_users_own_error_class_has_no_remedy_of_ours():
    class GripperBroken(AdrError):
        code = "gripper_broken"

    assert remedy_of(GripperBroken("it does not close").code) is None


def test_an_unknown_name_is_answered_with_the_nearest_one_and_the_list():
    message = str(UnknownName("task", "hoper", ["arm", "hopper"]))
    assert message == "there is no task 'hoper'; did you mean 'hopper'? accepted: arm, hopper"


def test_a_long_wrong_name_is_cut():
    assert len(str(UnknownName("task", "x" * 10_000, ["arm"]))) < 200


def test_an_exceeded_budget_names_its_numbers():
    message = str(BudgetExceeded("rollouts", used=3, asked=2, allowed=4))
    assert message == "rollouts: 3 used and 2 more asked for, but the budget is 4"
