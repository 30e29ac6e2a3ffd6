"""The progress of a part within a whole."""

import pytest

from adr_service.errors import InvalidInput
from adr_service.progress import Checkpoint, checked, part_of, silent


class Recorder:
    def __init__(self):
        self.calls = []

    def __call__(self, fraction, checkpoint=None, **facts):
        self.calls.append((fraction, checkpoint, facts))


@pytest.mark.parametrize(("done", "parts"), [(0, 1), (0, 4), (3, 4)])
def test_a_part_moves_the_whole_from_its_start_to_its_end(done, parts):
    recorder = Recorder()
    part = part_of(recorder, done, parts)
    for fraction in (0.0, 0.5, 1.0):
        part(fraction)
    fractions = [fraction for fraction, _, _ in recorder.calls]
    assert fractions == pytest.approx([done / parts, (done + 0.5) / parts, (done + 1) / parts])


def test_parts_of_parts_compose():
    recorder = Recorder()
    part_of(part_of(recorder, 1, 2), 1, 2)(0.5)
    assert recorder.calls[0][0] == pytest.approx(0.5 + 0.5 * 0.75)


def test_checkpoints_and_facts_pass_through_unchanged():
    recorder, checkpoint = Recorder(), Checkpoint(steps=7, content=b"policy", events=())
    part_of(recorder, 0, 2)(0.5, checkpoint, steps=7)
    assert recorder.calls == [(0.25, checkpoint, {"steps": 7})]


def test_silence_takes_the_same_arguments():
    assert silent(0.5, steps=3) is None


@pytest.mark.parametrize("fraction", [float("nan"), float("inf")])
def test_a_fraction_that_is_not_finite_is_refused(fraction):
    with pytest.raises(InvalidInput, match=f"the fraction that is done; given {fraction}"):
        checked(silent)(fraction)


def test_facts_are_text_that_can_be_sent():
    recorder = Recorder()
    checked(recorder)(0.5, file="a\udcff", found=list(range(1000)))
    [(_, _, facts)] = recorder.calls
    assert facts["file"] == "a\\udcff"
    assert (len(facts["found"]), facts["found"][:7]) == (201, "[0, 1, ")
