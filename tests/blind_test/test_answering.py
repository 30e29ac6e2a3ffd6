"""Criticism answers a question as `adr criticise` would, and says what it cost."""

import pytest

from adr_service.blind_test.answering import answer_question, by_criticism
from adr_service.blind_test.files import has_answer, write_question


@pytest.mark.slow
def test_criticism_names_the_effect_that_a_question_hides(tmp_path, case):
    write_question(tmp_path / "0000", case)
    answer = answer_question(by_criticism, tmp_path / "0000", tmp_path / "ours", seed=0)
    assert has_answer(tmp_path / "ours")
    (effect,) = case.effects
    assert (effect.kind, effect.location) in answer.groups()[0]
    assert answer.cpu_seconds is not None
    assert answer.cpu_seconds > 0
