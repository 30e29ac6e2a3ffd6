"""Records in the service's log."""

import io
import json
import logging
from contextlib import contextmanager

import pytest

from adr_service.specs import RunSpec
from api.logs import configure
from db import runs
from db.errors import DiskFull
from tests.service import until
from workers.cluster import RayOptions
from workers.orchestrator import Orchestrator
from workers.results import attempted

FORGED = "gone\n2026-01-01T00:00:00Z [info] all runs succeeded\x1b[2J\u2028\x9b31m"


@contextmanager
def configured(monkeypatch, form):
    """The service's log in this form, until the block ends."""
    output = io.StringIO()
    monkeypatch.setattr("sys.stderr", output)
    root = logging.getLogger()
    handlers, level = root.handlers[:], root.level
    root.handlers.clear()  # pytest's own must stay as they are
    try:
        configure(form)
        yield output
    finally:
        root.handlers[:], root.level = handlers, level


@pytest.fixture(params=["text", "json"])
def logged(request, monkeypatch):
    """The form, and the log of three failed stages."""
    with configured(monkeypatch, request.param) as output:
        secret = "a-token-of-somebody"  # noqa: S105
        try:
            raise ValueError(len(secret))
        except ValueError:
            logging.getLogger("workers").exception("it broke", extra={"run": "run_1"})
        logging.getLogger("workers").warning("stage failed: %s", FORGED, extra={"robot": FORGED})
        try:
            raise ValueError(FORGED)
        except ValueError:
            logging.getLogger("workers").exception("it broke again")
    return request.param, output.getvalue()


def test_a_record_has_its_level_its_ids_and_its_trace_and_no_values(logged):
    form, text = logged
    assert "a-token-of-somebody" not in text
    assert "ValueError: 19" in text
    if form == "json":
        record = json.loads(text.splitlines()[0])
        assert (record["event"], record["run"], record["level"]) == ("it broke", "run_1", "error")
    else:
        assert "it broke" in text
        assert "run=run_1" in text


def test_text_of_others_begins_no_line_and_controls_no_terminal(logged):
    form, text = logged
    assert not set("\x1b\x9b\u2028") & set(text)
    assert not [line for line in text.splitlines() if line.startswith("2026-01-01")]
    if form == "json":
        assert json.loads(text.splitlines()[1])["robot"] == FORGED
    else:
        assert r"succeeded\x1b[2J" in text


def write_to_a_full_disk(*_):
    raise DiskFull("the disk is full")


def test_trouble_with_the_database_is_logged_once_a_minute(monkeypatch):
    with configured(monkeypatch, "text") as output:
        for moment in (0.0, 1.0, 59.0, 61.0):
            monkeypatch.setattr("time.monotonic", lambda moment=moment: moment)
            for run in ("run_a", "run_b"):
                ids = {"run": run}
                attempted("results could not be stored", ids, write_to_a_full_disk)
                attempted("stages could not be begun", ids, write_to_a_full_disk)
    lines = output.getvalue().splitlines()
    assert len(lines) == 4
    assert sum("results could not be stored just now: the disk is full" in x for x in lines) == 2


def test_runs_that_wait_for_a_full_disk_do_not_each_log_it(file_database, monkeypatch):
    spec = RunSpec.model_validate({"task": "arm", "method": "prior", "preset": "smoke"})
    records = [runs.create_run(file_database, spec) for _ in range(3)]
    asked = []
    file_database.write = lambda name: asked.append(name) or write_to_a_full_disk()
    with configured(monkeypatch, "text") as output:
        orchestrator = Orchestrator(file_database, RayOptions())
        for record in records:
            orchestrator.submit(record)
        until(lambda: len(asked) >= 2 * len(records))
        orchestrator.close()
    assert output.getvalue().count("the disk is full; trying again in 1 s") == 1
