"""What a run or a benchmark does now, in a line."""

from adr_service.client.progress import headline, label

SPEC = {"task": "arm", "method": {"name": "simopt"}, "seed": 0}


def a_run(id, state, *stages, error=None):
    failure = {"code": "target_failed", "message": error} if error else None
    progress = [
        {"digest": f"{id}{i}", "kind": kind, "state": doing, "fraction": 0.5, "facts": {}}
        for i, (kind, doing) in enumerate(stages)
    ]
    return {"id": id, "state": state, "spec": SPEC, "progress": progress, "error": failure}


def test_the_headline_counts_stages_that_wait_for_cores_and_for_robots():
    waiting = [("target_episode", "waiting")] * 3
    seen = {
        "runs": [a_run("a", "running", ("infer", "running"), ("evaluate", "waiting"), *waiting)]
    }
    assert headline(seen) == (
        "0/1 runs done; now simopt/0 infer 50%; 1 stage waits for a core; "
        "3 episodes left for a robot of arm"
    )


def test_a_stage_that_two_runs_share_is_counted_once():
    run = a_run("a", "running", ("infer", "running"))
    assert headline({"runs": [run, run]}) == "0/2 runs done; now simopt/0 infer 50%"


def test_a_run_alone_is_as_a_benchmark_of_one():
    run = a_run("a", "succeeded")
    assert headline(run) == headline({"runs": [run]}) == "1/1 runs done"


def test_a_criticism_has_no_method_and_is_labelled_by_its_kind():
    assert label(SPEC) == "simopt"
    assert label({"kind": "criticism"}) == "criticism"


def test_a_run_on_the_data_of_another_collector_says_so():
    assert label({**SPEC, "collector": "simopt"}) == "simopt"
    assert label({**SPEC, "method": "dropo", "collector": "random"}) == "dropo on random"


def test_a_run_that_cannot_be_read_is_labelled_by_its_methods_name():
    assert label({"kind": "lost", "method": "median_best"}) == "median_best"
