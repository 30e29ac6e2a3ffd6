"""What the command line says of runs that it watches."""

import io

from rich.console import Console

from adr_service.errors import FailureCode
from api.display import failures, headline, results_table, verdict_table

SPEC = {"task": "arm", "method": {"name": "simopt"}, "seed": 0}


def a_run(id, state, *stages, error=None):
    failure = {"code": "target_failed", "message": error} if error else None
    progress = [
        {"digest": f"{id}{i}", "kind": kind, "state": doing, "fraction": 0.5, "facts": {}}
        for i, (kind, doing) in enumerate(stages)
    ]
    return {"id": id, "state": state, "spec": SPEC, "progress": progress, "error": failure}


def test_who_is_waited_for_is_said():
    waiting = [("target_episode", "waiting")] * 3
    seen = {
        "runs": [a_run("a", "running", ("infer", "running"), ("evaluate", "waiting"), *waiting)]
    }
    assert headline(seen) == (
        "0/1 runs done; now simopt/0 infer 50%; 1 stages wait for a core; "
        "3 episodes wait for a robot of arm"
    )


def test_a_failed_run_has_its_reason_and_a_remedy():
    seen = {"runs": [a_run("a", "succeeded"), a_run("b", "failed", error="the motor is hot")]}
    assert headline(seen) == "1/2 runs done, others failed"
    remedy = FailureCode.TARGET_FAILED.remedy
    assert failures(seen) == [f"b failed: the motor is hot\n    {remedy}"]


def test_names_of_causes_are_not_wrapped_on_narrow_terminals():
    cause = {
        "kind": "joint_asymmetric_viscous_friction",
        "location": "joint:foot_left_joint",
        "parameters": {"friction": {"value": 1.0, "low": 0.5, "high": 1.5, "unit": "N m s/rad"}},
        "gain_nats": 30.0,
    }
    verdict = {
        "verdict": "cause",
        "confidence": 0.99,
        "causes": [cause],
        "tied": [[]],
        "residual": {"rest": "none", "parameters": {}},
        "gain": None,
        "remarks": [],
    }
    console = Console(file=(output := io.StringIO()), width=80)
    console.print(verdict_table(verdict))
    assert f"{cause['kind']}  {cause['location']}" in output.getvalue()


def test_a_results_row_keeps_its_names_and_interval_on_80_columns():
    row = {"task": "half_cheetah", "variant": "unmodeled", "method": "simopt", "iteration": 5}
    row |= {"collector": "simopt", "normalised_return": 0.99, "low": 0.12, "high": 1.03}
    row |= {"seeds": 3, "episodes": 150, "target_transitions": 1000}
    row |= {"estimation_error": 0.12, "posterior_std": 0.012}
    shown = io.StringIO()
    Console(file=shown, width=80).print(results_table({"rows": [row], "note": ""}))
    assert "[0.12, 1.03]" in shown.getvalue()
    assert "…" not in shown.getvalue()
