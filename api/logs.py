"""The service's log: lines for people, or JSON for machines.

Records of a run's thread have its `run`. Records of a stage that begins, finishes, is lost or fails
have `run`, `stage`, `kind` and `attempt`.
"""

import io
import logging
import math
import sys
import time
from typing import Literal, TextIO

import structlog

from adr_service.json_values import printable

LogFormat = Literal["text", "json"]
_OUTAGES = "workers.outages"  # where each run says every second that the database cannot be used
_QUIET_S = 60.0  # between two equal lines of these


def configure(log_format: LogFormat) -> None:
    """Send all records of this process to standard error, in one form."""
    known = [
        structlog.contextvars.merge_contextvars,
        structlog.stdlib.add_log_level,
        structlog.stdlib.add_logger_name,
        structlog.stdlib.ExtraAdder(),
        structlog.processors.TimeStamper("iso", utc=True),
        _without_others,
    ]
    form: list[structlog.typing.Processor] = [
        structlog.stdlib.ProcessorFormatter.remove_processors_meta
    ]
    if log_format == "json":
        form += [structlog.processors.format_exc_info, structlog.processors.JSONRenderer()]
    else:
        form += [
            _as_one_record,
            structlog.dev.ConsoleRenderer(
                colors=sys.stderr.isatty(),
                pad_event_to=0,
                exception_formatter=_trace,
            ),
        ]
    handler = logging.StreamHandler()
    handler.addFilter(_OnceAMinute())
    handler.setFormatter(
        structlog.stdlib.ProcessorFormatter(foreign_pre_chain=known, processors=form)
    )
    logging.basicConfig(level=logging.INFO, handlers=[handler], force=True)
    logging.getLogger("alembic").setLevel(logging.WARNING)  # it also reports models in memory


class _OnceAMinute(logging.Filter):
    """Drops what an outage repeats, whichever run says it: its log should fill no disk."""

    def __init__(self) -> None:
        super().__init__()
        self._shown: dict[str, float] = {}  # texts, each with the moment when it was shown last

    def filter(self, record: logging.LogRecord) -> bool:
        if record.name != _OUTAGES:
            return True
        text, now = record.getMessage(), time.monotonic()
        if now - self._shown.get(text, -math.inf) < _QUIET_S:
            return False
        shown = list(self._shown.items())  # other threads add to it
        self._shown = {each: at for each, at in [*shown, (text, now)] if now - at < _QUIET_S}
        return True


def _trace(output: TextIO, error: structlog.typing.ExcInfo) -> None:
    """Write a plain traceback: others print values of secrets. Its message is indented."""
    plain = io.StringIO()
    structlog.dev.plain_traceback(plain, error)
    output.write(_indented(plain.getvalue()))


def _indented(text: str) -> str:
    return printable(text).replace("\n", "\n    ")


def _as_one_record(
    logger: structlog.typing.WrappedLogger, name: str, event: structlog.typing.EventDict
) -> structlog.typing.EventDict:
    """Indent text that others wrote, so that it begins no line and controls no terminal."""
    for key, value in event.items():
        if isinstance(value, str):
            event[key] = _indented(value)
    return event


def _without_others(
    logger: structlog.typing.WrappedLogger, name: str, event: structlog.typing.EventDict
) -> structlog.typing.EventDict:
    """Remove fields that uvicorn and Ray add for their own handlers."""
    for key in ("color_message", "_ray_timestamp_ns"):
        event.pop(key, None)
    return event
