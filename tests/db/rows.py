"""Rows for the database's tests, and what they look at."""

from contextlib import contextmanager
from dataclasses import replace

import numpy as np
from sqlalchemy import Engine, text
from sqlalchemy import event as engine_event

from adr_service.benchmark.cost import Execution
from adr_service.events import StageFinished
from adr_service.json_values import canonical_json
from adr_service.specs import BenchmarkSpec, RunSpec
from adr_service.stages.base import StageResult
from adr_service.transitions import TransitionDataset
from db import events, stages
from tests.stages.examples import evaluation

SPEC = RunSpec.model_validate({"task": "arm", "method": "prior", "preset": "smoke"})
RESULT = StageResult({"returns": [0.1, 1 / 3]}, {"policy": b"\0bytes", "data": b""})
EXECUTION = Execution(
    attempt=1,
    started_by="run_a",
    asked=100.0,
    placed=101.0,
    began=101.5,
    ended=102.0,
    cpu=0.4,
    preparing=0.1,
    is_first=True,
    cores=2,
    provenance={"python": "3.11"},
)
# as of a robot's episode, which takes no core
UNMEASURED = replace(EXECUTION, cpu=None, preparing=None, is_first=None, cores=None)


STAGE = evaluation(1)


def benchmark_spec(**changes):
    """A small benchmark."""
    given = {"tasks": ["arm"], "methods": ["simopt"], "seeds": [0], "preset": "smoke"}
    return BenchmarkSpec.model_validate({**given, **changes})


def commit(database, stage, result, *run_ids, execution=EXECUTION):
    """Store a stage's result, and write it to the record of runs."""
    event = StageFinished(kind=stage.kind, digest=stage.digest)
    with database.write("commit") as session:
        document = canonical_json(stage.document)
        stages.add_result(session, stage.digest, document, result, execution)
        for run_id in run_ids:
            events.append(session, run_id, event)


def stored(database, digest):
    """The stored result of a stage."""
    with database.read() as session:
        return stages.find_result(session, digest)


def count(database, table):
    """The number of rows of a table."""
    with database.read() as session:
        return session.scalar(text(f"select count(*) from {table}"))  # noqa: S608 - our own names


def a_recording():
    """The `.npz` of two episodes."""
    rows = np.arange(16.0).reshape(4, 4)
    episodes, columns = np.array([0, 0, 1, 1]), tuple("abcd")
    return TransitionDataset(rows, rows[:, :2], rows, episodes, 0.02, columns, "test").to_npz()


@contextmanager
def statements():
    """Collect the statements that are sent to any database meanwhile."""
    sent = []

    def note(connection, cursor, statement, *_):
        sent.append(statement)

    engine_event.listen(Engine, "before_cursor_execute", note)
    try:
        yield sent
    finally:
        engine_event.remove(Engine, "before_cursor_execute", note)
