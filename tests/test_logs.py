"""What the service's log has of a record."""

import io
import json
import logging

import pytest

from api.logs import configure


@pytest.fixture(params=["text", "json"])
def told(request, monkeypatch):
    """What was logged of a defect in a stage, in each form."""
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
    finally:
        root.handlers[:], root.level = handlers, level
    return request.param, output.getvalue()


def test_a_record_has_its_level_its_ids_and_its_trace_and_no_values(told):
    form, text = told
    assert "a-token-of-somebody" not in text
    assert "ValueError: 19" in text
    if form == "json":
        record = json.loads(text)
        assert (record["event"], record["run"], record["level"]) == ("it broke", "run_1", "error")
    else:
        assert "it broke" in text
        assert "run=run_1" in text
