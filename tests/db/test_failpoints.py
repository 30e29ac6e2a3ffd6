"""Points at which a process can be killed; each test is a process of its own."""

import pytest

from tests.packages import python

PROGRAM = """
import logging
logging.basicConfig(level="INFO", format="%(message)s")
from db.failpoints import failpoint
failpoint("first")
failpoint("second")
print("passed both")
"""


def test_without_a_choice_a_process_passes_silently(monkeypatch):
    monkeypatch.delenv("ADR_FAILPOINT", raising=False)
    done = python(PROGRAM)
    assert (done.returncode, done.stdout, done.stderr) == (0, "passed both\n", "")


@pytest.mark.parametrize("name", ["first", "second"])
def test_a_process_ends_at_the_chosen_point_as_if_it_were_killed(monkeypatch, name):
    monkeypatch.setenv("ADR_FAILPOINT", name)
    done = python(PROGRAM)
    assert (done.returncode, done.stdout) == (137, "")


def test_a_list_names_the_points_in_their_order(monkeypatch):
    monkeypatch.setenv("ADR_FAILPOINT", "list")
    done = python(PROGRAM)
    assert done.stderr.splitlines() == ["failpoint first", "failpoint second"]
    assert done.stdout == "passed both\n"
