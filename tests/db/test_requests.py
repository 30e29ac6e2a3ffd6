"""Requests that come twice under one Idempotency-Key."""

import pytest

from db import benchmarks, runs
from db.requests import KeyReused, Replayed, RequestKey
from tests.db.rows import SPEC, benchmark_spec, count

KEY = RequestKey("a client's key", "digest of the request")


def test_the_same_request_names_what_it_created_and_creates_nothing_more(database):
    run = runs.create_run(database, SPEC, KEY)
    with pytest.raises(Replayed) as replayed:
        runs.create_run(database, SPEC, KEY)
    assert replayed.value.id == run.id
    assert count(database, "runs") == 1


def test_another_request_under_the_same_key_is_refused(database):
    runs.create_run(database, SPEC, KEY)
    with pytest.raises(KeyReused, match="use a new key"):
        benchmarks.create_benchmark(database, benchmark_spec(), RequestKey(KEY.key, "another"))
    assert count(database, "benchmarks") == 0


def test_a_request_without_a_key_creates_a_run_each_time(database):
    assert runs.create_run(database, SPEC).id != runs.create_run(database, SPEC).id


def test_a_refused_request_may_come_again_under_its_key(database):
    def refuse(live):
        raise ValueError(live)

    with pytest.raises(ValueError, match="1"):
        runs.create_run(database, SPEC, KEY, refuse)
    assert runs.create_run(database, SPEC, KEY).state == "queued"
