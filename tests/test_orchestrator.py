"""Which runs get a thread, and when; their programs are ours, and need no Ray."""

import sqlite3
from contextlib import closing
from pathlib import Path

import pytest

from adr_service.errors import InvalidInput
from adr_service.specs import RunSpec
from db import runs
from tests.service import until
from workers.cluster import RayOptions
from workers.orchestrator import Orchestrator

SPEC = RunSpec.model_validate({"task": "arm", "method": "prior", "preset": "smoke"})


@pytest.fixture
def orchestrator(file_database):
    return Orchestrator(file_database, RayOptions())  # it is not started


def test_a_run_whose_end_cannot_be_stored_yet_is_not_begun_again(
    file_database, orchestrator, tmp_path: Path, monkeypatch
):
    file = tmp_path / "adr.sqlite"
    begun = []
    with closing(sqlite3.connect(file, isolation_level=None, check_same_thread=False)) as other:

        def program(*_):
            begun.append(1)
            other.execute("begin immediate")
            raise InvalidInput("nothing can be computed")

        monkeypatch.setattr("workers.orchestrator.run", program)
        record = runs.create_run(file_database, SPEC)
        for _ in range(3):
            orchestrator.adopt()
            until(lambda: begun)
        other.execute("rollback")
        until(lambda: runs.get_run(file_database, record.id).state == "failed")
        assert begun == [1]
        orchestrator.submit(record)  # as it was read before it ended
        again = runs.resubmit(file_database, record.id)
        orchestrator.submit(again)
        until(lambda: len(begun) == 2)
        other.execute("rollback")
        until(lambda: runs.get_run(file_database, record.id).state == "failed")
    assert begun == [1, 1]
