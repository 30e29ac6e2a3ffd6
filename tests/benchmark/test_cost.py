"""Use of core seconds, on executions whose answer is computed by hand."""

import pytest

from adr_service.benchmark.cost import Execution, Utilisation, utilisation


def execution(asked, placed, began, ended, **changes):
    given = {"cpu": ended - began, "preparing": 0.0, "is_first": False, "cores": 2, **changes}
    times = {"asked": asked, "placed": placed, "began": began, "ended": ended}
    return Execution(attempt=1, started_by="run_a", **times, **given)


def test_two_stages_that_compute_all_the_time_use_both_cores():
    used = utilisation([execution(0, 0, 0, 10), execution(0, 0, 0, 10)])
    assert (used.cores, used.seconds, used.computing) == (2, 10, 20)
    assert (used.useful, used.overhead) == (1, 0)


def test_times_with_less_work_than_cores_do_not_count():
    """Between 10 and 30 one core could not have been busy."""
    used = utilisation([execution(0, 0, 0, 30), execution(0, 0, 0, 10)])
    assert (used.seconds, used.computing) == (10, 20)
    assert utilisation([execution(0, 0, 0, 30)]) is None
    assert utilisation([]) is None


def test_a_core_that_is_free_while_a_stage_waits_is_orchestration():
    used = utilisation([execution(0, 0, 0, 10), execution(0, 4, 5, 10)])
    assert used.orchestration == pytest.approx(4 + 1)
    assert used.overhead == pytest.approx(5 / 20)
    assert used.useful == pytest.approx(15 / 20)


def test_starting_and_preparing_are_neither_computing_nor_orchestration():
    late = execution(0, 0, 3, 10, is_first=True, preparing=2.0)
    used = utilisation([execution(0, 0, 0, 10), late])
    assert (used.starting, used.preparing, used.computing) == pytest.approx((3, 2, 15))
    assert (used.useful, used.overhead) == pytest.approx((1, 0))


def test_a_stage_without_a_cpu_waits():
    """Others had it: a quarter of the window's core seconds did no work."""
    used = utilisation([execution(0, 0, 0, 10), execution(0, 0, 0, 10, cpu=5.0)])
    assert used.waiting == pytest.approx(5)
    assert used.useful == pytest.approx(0.75)


def test_everything_adds_up():
    executions = [
        execution(0, 0.1, 1, 4, cpu=2.5, preparing=0.5, is_first=True),
        execution(0, 0.2, 0.3, 7, cpu=6),
        execution(2, 4.2, 4.3, 9, cpu=4),
        execution(3, 7.1, 7.2, 12, cpu=4.5),
    ]
    used = utilisation(executions)
    parts = (
        used.computing,
        used.starting,
        used.preparing,
        used.waiting,
        used.orchestration,
    )
    assert all(part >= 0 for part in parts)
    assert sum(parts) == pytest.approx(used.cores * used.seconds)


def test_cores_that_join_later_were_not_free_before():
    """Two stages at a time for ten seconds, then four: nothing is left over."""
    first = [execution(0, 0, 0, 10), execution(0, 0, 0, 10)]
    then = [execution(0, 10, 10, 20, cores=4) for _ in range(4)]
    used = utilisation([*first, *then])
    assert (used.cores, used.seconds, used.computing) == (4, 20, 60)
    assert (used.useful, used.overhead) == (1, 0)
    last = [execution(0, 20, 20, 30, cores=1), execution(0, 30, 30, 40, cores=1)]
    again = utilisation([*first, *then, *last])
    assert (again.cores, again.seconds, again.computing, again.orchestration) == (4, 40, 80, 0)


def test_a_robots_episode_takes_no_core():
    episode = execution(0, 0, 0, 50, cpu=None, preparing=None, is_first=None, cores=None)
    assert not episode.is_measured
    assert episode.seconds == 50
    both = [execution(0, 0, 0, 10), execution(0, 0, 0, 10)]
    assert utilisation([*both, episode]) == utilisation(both)
    assert utilisation([episode]) is None


def test_the_json_of_a_utilisation_has_its_shares():
    used = Utilisation(
        cores=2,
        seconds=10.0,
        computing=15.0,
        starting=0.0,
        preparing=0.0,
        waiting=0.0,
        orchestration=5.0,
    )
    shown = used.model_dump(mode="json")
    assert (shown["useful"], shown["overhead"], shown["cores"]) == (0.75, 0.25, 2)
