"""Starting a Ray cluster of our own."""

import os

from workers.cluster import RayOptions


def test_cores_that_this_process_may_not_use_are_not_counted():
    mine = os.sched_getaffinity(0)
    try:
        os.sched_setaffinity(0, {min(mine)})
        assert RayOptions().cpus_to_count == 1
    finally:
        os.sched_setaffinity(0, mine)
    assert 1 <= RayOptions().cpus_to_count <= len(mine)  # a container may have fewer


def test_cores_that_are_asked_for_are_counted():
    assert RayOptions(cpus=3).cpus_to_count == 3
