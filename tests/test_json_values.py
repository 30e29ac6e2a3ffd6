"""JSON values: one text for equal values, and clear errors for wrong ones."""

import json

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydantic import ValidationError

from adr_service.json_values import (
    Line,
    Paragraphs,
    Wire,
    canonical_json,
    explain,
    is_a_line,
    printable,
    sha256,
)

json_values = st.recursive(
    st.none()
    | st.booleans()
    | st.integers()
    | st.floats(allow_nan=False, allow_infinity=False)
    | st.text(),
    lambda inner: st.lists(inner) | st.dictionaries(st.text(), inner),
    max_leaves=10,
)


class Box(Wire):
    width: float = 1.0
    name: str = ""


class Label(Wire):
    title: Line
    text: Paragraphs


@given(json_values)
def test_the_canonical_text_reads_back_as_the_value_and_is_stable(value):
    text = canonical_json(value)
    assert json.loads(text) == value
    assert canonical_json(json.loads(text)) == text


def test_the_order_of_keys_does_not_matter():
    assert canonical_json({"b": 1, "a": [2.5]}) == canonical_json({"a": [2.5], "b": 1})
    assert canonical_json({"b": 1, "a": [2.5]}) == '{"a":[2.5],"b":1}'


@pytest.mark.parametrize("bad", [float("nan"), float("inf")])
def test_numbers_that_json_does_not_have_are_refused(bad):
    with pytest.raises(ValueError, match="not JSON compliant"):
        canonical_json([bad])
    with pytest.raises(ValidationError, match="finite"):
        Box(width=bad)


def test_the_hash_is_sha_256():
    assert sha256(b"abc").startswith("ba7816bf8f01cfea")  # FIPS 180-2, B.1


def test_an_unknown_field_is_answered_with_the_nearest_one():
    with pytest.raises(ValidationError, match=r"did you mean 'width'\? accepted: width, name"):
        Box.model_validate({"widht": 2.0})


def test_a_value_cannot_be_changed_and_takes_no_other_type():
    with pytest.raises(ValidationError, match="frozen"):
        Box().width = 2.0
    with pytest.raises(ValidationError, match="valid number"):
        Box.model_validate({"width": "2.0"})


def test_an_error_is_explained_in_one_line_with_the_place():
    with pytest.raises(ValidationError) as raised:
        Box.model_validate({"width": "wide", "name": 3})
    explained = explain(raised.value, "the box")
    assert explained.startswith("width: ")
    assert "; name: " in explained
    with pytest.raises(ValidationError) as raised:
        Box.model_validate({"depth": 1})
    assert explain(raised.value, "the box").startswith("the box: there is no field 'depth'")


def test_a_text_with_control_characters_is_refused_in_words():
    with pytest.raises(ValidationError) as raised:
        Label(title="two\nlines", text="a\x1b[2J")
    assert explain(raised.value, "the label") == (
        "title: expected is one line of text without control characters; "
        "text: expected is text without control characters"
    )


@pytest.mark.parametrize("text", ["a\nb", "\x1b[2J", "a\tb", "\u202e", "\x7f"])
def test_control_characters_do_not_make_a_line_and_are_escaped_for_printing(text):
    assert not is_a_line(text)
    assert is_a_line(printable(text).replace("\n", "").replace("\t", ""))


def test_ordinary_text_is_a_line_and_is_printed_as_it_is():
    assert is_a_line("Größe 3 µm – ok")
    assert printable("Größe 3 µm – ok\n\tok") == "Größe 3 µm – ok\n\tok"
