"""Records in the service's log."""

import io
import json
import logging

import pytest

from api.logs import configure

FORGED = "gone\n2026-01-01T00:00:00Z [info] all runs succeeded\x1b[2J\u2028\x9b31m"


@pytest.fixture(params=["text", "json"])
def logged(request, monkeypatch):
    """The form, and the log of three failed stages."""
    output = io.StringIO()
    monkeypatch.setattr("sys.stderr", output)
    root = logging.getLogger()
    handlers, level = root.handlers[:], root.level
    root.handlers.clear()  # pytest's own must stay as they are
    try:
        configure(request.param)
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
    finally:
        root.handlers[:], root.level = handlers, level
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
