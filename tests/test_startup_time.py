"""The clock of preparations adds up."""

import time

import pytest

from adr_service.startup_time import add_preparation, preparation_seconds, preparing


def test_added_seconds_are_counted():
    before = preparation_seconds()
    add_preparation(2.5)
    add_preparation(0.5)
    assert preparation_seconds() - before == pytest.approx(3.0)


def test_a_preparation_that_fails_is_counted_too_by_the_cpus_clock(monkeypatch):
    before = preparation_seconds()
    clock = iter([2.0, 2.5])
    monkeypatch.setattr(time, "process_time", lambda: next(clock))
    with pytest.raises(ImportError), preparing():
        raise ImportError
    assert preparation_seconds() - before == pytest.approx(0.5)
