"""Errors that say what was given and what is accepted, and the reasons for which a run can fail."""

import re
from pathlib import Path

import pytest

from adr_service import errors
from adr_service.errors import (
    AdrError,
    BudgetExceeded,
    FailureCode,
    InvalidInput,
    StageFailed,
    UnknownName,
    remedy_of,
)

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


def test_every_error_is_an_adr_error_and_has_a_code_of_its_own():
    kinds = [k for k in vars(errors).values() if isinstance(k, type) and issubclass(k, AdrError)]
    codes = [kind.code for kind in kinds]
    assert len(set(codes)) == len(codes) > 5


def test_an_unknown_name_is_answered_with_the_nearest_and_all_accepted_names():
    error = UnknownName("task", "hoper", ["arm", "hopper"])
    assert str(error) == "there is no task 'hoper'; did you mean 'hopper'? accepted: arm, hopper"


def test_a_name_that_resembles_none_gets_no_suggestion():
    error = UnknownName("task", "zzz", ["arm", "hopper"])
    assert str(error) == "there is no task 'zzz'; accepted: arm, hopper"


def test_an_unknown_name_is_an_invalid_input_and_a_lookup_error():
    for kind in (InvalidInput, LookupError):
        with pytest.raises(kind):
            raise UnknownName("task", "a", ["b"])


def test_a_long_wrong_name_is_shortened_in_the_message():
    message = str(UnknownName("task", "x" * 5000, ["arm"]))
    assert f"'{'x' * 100}…'" in message
    assert len(message) < 200


def test_an_exceeded_budget_states_all_three_numbers():
    error = BudgetExceeded("target rollouts", 3, 2, 4)
    assert str(error) == "target rollouts: 3 used and 2 more asked for, but the budget is 4"


def test_a_failed_stage_keeps_its_cause_apart_from_its_message():
    error = StageFailed("train_policy 1", "worker_lost", "three attempts were lost")
    assert error.cause == "worker_lost"
    assert str(error) == "train_policy 1: three attempts were lost"
