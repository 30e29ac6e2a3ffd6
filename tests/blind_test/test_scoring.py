"""Scores of answers whose worth is known."""

import pytest

from adr_service.blind_test.files import Answer, Key
from adr_service.blind_test.scoring import (
    Marked,
    are_all_named,
    errors_of,
    has_no_false_second,
    is_named,
    is_silent,
    is_unknown,
    marked,
    score,
    share,
)
from adr_service.effects.base import Effect
from adr_service.effects.catalogue import get_mechanism
from tests.blind_test.conftest import BIAS, hidden

SPRING = Effect("joint_spring", "joint:elbow", (2.0,))
TWO = hidden("two", effects=(BIAS, SPRING))


def named(effect, value=None, **interval):
    strength = get_mechanism(effect.kind).strengths[0].name
    estimates = {} if value is None else {strength: {"value": value, **interval}}
    return {"kind": effect.kind, "location": effect.location, "parameters": estimates}


def answer(*causes, tied=None, verdict="cause", **rest):
    groups = tied or [[] for _ in causes]
    return Answer.model_validate(
        {"verdict": verdict, "causes": causes, "tied": groups, **rest}, strict=False
    )


def test_an_effect_is_named_by_its_kind_and_its_place():
    assert is_named(Marked(hidden(), answer(named(BIAS))))
    assert not is_named(Marked(hidden(), answer(named(SPRING))))
    elsewhere = Effect(BIAS.kind, "actuator:elbow", (1.0,))
    assert not is_named(Marked(hidden(), answer(named(elsewhere))))


def test_a_false_name_beside_the_right_one_is_wrong():
    assert not is_named(Marked(hidden(), answer(named(BIAS), named(SPRING))))


def test_a_false_second_is_one_beside_a_right_one():
    beside = answer(named(BIAS), named(SPRING))
    assert not has_no_false_second(Marked(hidden(), beside))
    assert has_no_false_second(Marked(TWO, beside))
    tied = answer(named(BIAS), tied=[[named(SPRING)]])
    assert has_no_false_second(Marked(hidden(), tied))
    assert has_no_false_second(Marked(hidden(), answer(named(SPRING))))
    assert has_no_false_second(Marked(hidden(), answer(verdict="none")))


def test_a_tie_of_three_names_its_effects_and_a_larger_one_only_if_asked():
    others = [named(Effect("joint_spring", f"joint:{n}", (1.0,))) for n in range(3)]
    three = Marked(hidden(), answer(others[0], tied=[[named(BIAS), others[1]]]))
    four = Marked(hidden(), answer(others[0], tied=[[named(BIAS), *others[1:]]]))
    assert is_named(three)
    assert not is_named(four)
    assert is_named(four, most_tied=4)


def test_what_is_never_hidden_makes_no_tie_too_large():
    others = [named(Effect("body_load", f"body:{n}", (1.0, 0.0, 0.0, 0.0))) for n in range(3)]
    assert is_named(Marked(hidden(), answer(named(BIAS), tied=[others])))
    assert not is_named(Marked(hidden(), answer(named(BIAS), others[0])))


def test_of_two_effects_both_have_to_be_named():
    assert not are_all_named(Marked(TWO, answer(named(SPRING))))
    assert is_named(Marked(TWO, answer(named(SPRING))))
    assert are_all_named(Marked(TWO, answer(named(SPRING), named(BIAS))))
    assert not are_all_named(Marked(TWO, answer(named(SPRING), tied=[[named(BIAS)]])))


def test_causes_beside_a_verdict_of_unknown_are_not_named():
    assert not is_named(Marked(hidden(), answer(named(BIAS), verdict="unknown")))


def test_the_strength_is_found_by_its_name():
    drag = Effect("wind", "global", (1.2, 2.0, 0.0))
    cause = named(drag)
    cause["parameters"] = {"speed x": {"value": 9.0}, "density": {"value": 1.2}}
    assert errors_of(Marked(hidden(effects=(drag,)), answer(cause))) == (0.0, None)


def test_an_unbounded_interval_covers_nothing():
    cause = named(BIAS, -0.12, low=None, high=None)
    assert errors_of(Marked(hidden(), answer(cause))) == (0.0, None)


def test_a_rest_that_is_unknown_counts_as_unknown():
    assert is_unknown(Marked(hidden(), answer(named(BIAS), residual={"rest": "unknown"})))
    assert not is_unknown(Marked(hidden(), answer(named(BIAS))))
    assert is_unknown(Marked(hidden(), answer(verdict="unknown")))


def test_a_case_without_an_answer_is_wrong_in_every_line():
    cases = [
        hidden(),
        TWO,
        hidden("none", 0.0, ()),
        hidden("outside", 1.0, (), "gain_drift"),
    ]
    lines = score([Marked(case, None) for case in cases])
    assert lines.pop("answered") == "0 of 4"
    shares = [text for text in lines.values() if "%" in text]
    assert len(shares) == 14
    assert all(text.startswith("0 of ") for text in shares)


@pytest.mark.parametrize(
    ("value", "low", "high", "covers"),
    [
        (-0.12, -0.13, -0.11, True),
        (-0.12, -0.13, None, True),
        (-0.105, -0.11, -0.1, False),
        (-0.105, None, -0.1, True),
        (-0.105, -0.11, None, False),
        (-0.14, -0.15, -0.13, False),
        (-0.14, None, -0.13, False),
    ],
)
def test_an_interval_covers_the_truth_between_its_ends(value, low, high, covers):
    """Without an end it is open on that side; the truth is -.12."""
    case = Marked(hidden(), answer(named(BIAS, value, low=low, high=high)))
    assert errors_of(case)[1] is covers


def test_answers_are_scored_by_kind_and_ratio():
    cases = [
        Marked(hidden(ratio=0.3), answer(named(BIAS, -0.132, low=-0.14, high=-0.11))),
        Marked(hidden(ratio=0.3), answer(named(BIAS, -0.126, low=None, high=-0.11))),
        Marked(hidden(ratio=1.0), answer(named(BIAS), cpu_seconds=4.0)),
        Marked(hidden(ratio=1.0), answer(verdict="none", cpu_seconds=2.0)),
        Marked(hidden("none", 0.0, ()), answer(verdict="none")),
        Marked(hidden("outside", 0.1, (), "gain_drift"), answer(verdict="unknown")),
    ]
    lines = score(cases)
    assert lines["one effect, ratio 0.3: named"].startswith("2 of 2 = 100 %")
    assert lines["one effect, ratio 1: named"].startswith("1 of 2 = 50 %")
    assert lines["one effect, ratio 0.03: named"] == "no cases"
    assert lines["one effect, ratio 0.3 or above: named"].startswith("3 of 4 = 75 %")
    assert lines["outside the catalogue, ratio 0.3 or above: unknown"] == "no cases"
    assert lines["nothing hidden: none"].startswith("1 of 1")
    assert lines["outside the catalogue, ratio 0.1: unknown"].startswith("1 of 1")
    assert lines["in the catalogue, or nothing: not unknown"].startswith("5 of 5")
    assert lines["error of the strength, median"] == "7.5 % of 2"  # 10 and 5
    assert lines["95 % intervals that cover the strength"].startswith("2 of 2")
    assert lines["outside the catalogue: no effect named"].startswith("1 of 1")
    assert lines["CPU seconds per case, quartiles"] == "2.5, 3.0, 3.5"


def test_the_interval_of_a_share_is_clopper_and_pearsons():
    cases = [Marked(hidden(), answer(verdict="none")) for _ in range(8)]
    assert share(cases, is_silent) == "8 of 8 = 100 % [63, 100]"  # .025 ** (1 / 8) = .63


def test_cases_are_marked_by_their_names():
    key = Key(seed=1, cases={"0000": hidden(), "0001": TWO})
    given = answer(named(BIAS))
    assert marked(key, {"0001": given}) == [Marked(hidden(), None), Marked(TWO, given)]


@pytest.mark.parametrize("kind", ["one", "two"])
def test_a_score_without_cases_says_so(kind):
    assert {text for name, text in score([]).items() if kind in name} == {"no cases"}
