"""Following a run to its end: the results, and the exit status."""

import json
from contextlib import nullcontext

import pytest
import typer

from api.cli import results, runs
from api.cli.follow import follow

SPEC = {"task": "arm", "method": {"name": "simopt"}, "seed": 0}


class Service:
    """A client whose run has ended as the test says."""

    def __init__(self, state, spec=SPEC, message=None):
        error = {"code": "target_failed", "message": message} if message else None
        self.end = {"id": "run_a", "state": state, "spec": spec, "progress": [], "error": error}

    def watch(self, id):
        yield self.end

    def get(self, id):
        return self.end

    def results(self, id):
        return {"rows": [], "estimates": []}

    def criticism(self, id):
        return {"verdict": None}


def test_a_run_that_succeeded_ends_without_an_error(capsys):
    follow(Service("succeeded"), "run_a")
    assert "1/1 runs done" in capsys.readouterr().out


@pytest.mark.parametrize("state", ["failed", "cancelled"])
def test_any_other_end_has_exit_status_1(state):
    with pytest.raises(typer.Exit) as end:
        follow(Service(state), "run_a")
    assert end.value.exit_code == 1


def test_the_reason_of_a_failure_is_an_error_and_no_markup(capsys):
    with pytest.raises(typer.Exit):
        follow(Service("failed", message="the gripper [bold]broke"), "run_a")
    assert "the gripper [bold]broke" in capsys.readouterr().err


def test_a_criticism_without_a_verdict_shows_its_state(capsys):
    spec = {"kind": "criticism", "task": "arm", "seed": 0}
    with pytest.raises(typer.Exit):
        follow(Service("cancelled", spec), "run_a")
    assert "cancelled: no verdict yet" in capsys.readouterr().out


CRITICISM = Service("succeeded", {"kind": "criticism", "task": "arm", "seed": 0})


def test_the_results_of_a_criticism_are_its_verdict(adr_here, monkeypatch):
    monkeypatch.setattr(results, "connect", lambda url: nullcontext(CRITICISM))
    status, shown, _ = adr_here("results", "run_a", "--json")
    assert (status, json.loads(shown)) == (0, {"verdict": None})
    status, _, errors = adr_here("results", "run_a", "--compare")
    assert status == 2
    assert "run_a is a criticism, which has a verdict and nothing for --compare" in errors


def test_a_comparison_as_json_is_a_document(adr_here, monkeypatch):
    monkeypatch.setattr(results, "connect", lambda url: nullcontext(Service("succeeded")))
    status, shown, _ = adr_here("results", "run_a", "--compare", "--json")
    assert (status, json.loads(shown)) == (0, {"rows": [], "estimates": []})


def test_the_id_of_what_is_watched_is_on_the_error_stream_before_it_is_asked_for(capsys):
    class Watched(Service):
        def watch(self, id):
            assert capsys.readouterr().err.startswith("run_a, as before")
            yield self.end

    runs._show(Watched("succeeded"), {"id": "run_a"}, ", as before", False, True, True)
    assert json.loads(capsys.readouterr().out)["id"] == "run_a"


class Stopping:
    """A client whose run stops when it has been looked at some times."""

    def __init__(self, looks):
        self.left = looks

    def get(self, id):
        self.left -= 1
        state = "running" if self.left >= 0 else "cancelled"
        return {"id": id, "state": state, "cancel_requested": True}

    def resume(self, id):
        return {"id": id}


def test_a_run_that_is_being_cancelled_is_resumed_once_it_has_stopped(adr_here, monkeypatch):
    client = Stopping(3)
    monkeypatch.setattr(runs, "connect", lambda url: nullcontext(client))
    monkeypatch.setattr(runs.time, "sleep", lambda seconds: None)
    assert adr_here("resume", "run_a")[:2] == (0, "run_a goes on\n")
    assert client.left == -1
