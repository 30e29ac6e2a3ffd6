"""Starting a Ray cluster of our own."""

import pytest

from workers.cluster import RayOptions


@pytest.mark.parametrize(
    ("cpus", "usable", "count"),
    [(None, {0, 1, 2, 3}, None), (None, {2}, 1), (3, {2}, 3), (3, {0, 1, 2, 3}, 3)],
)
def test_cores_that_this_process_may_not_use_are_not_counted(cpus, usable, count, monkeypatch):
    monkeypatch.setattr("os.cpu_count", lambda: 4)
    monkeypatch.setattr("os.sched_getaffinity", lambda process: usable)
    assert RayOptions(cpus=cpus).cpus_to_count == count
