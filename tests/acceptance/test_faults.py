"""The service dies at every transaction, before and after it is on disk; nothing is lost."""

import json
import re
import sqlite3
import sys
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing
from itertools import repeat
from pathlib import Path

import pytest

from adr_service.client import AdrClient, Unreachable
from tests.recordings import recording
from tests.service import NotStarted, start_service, wait_until_finished

pytestmark = [pytest.mark.ray, pytest.mark.slow]
TRAINING = {"max_steps": 1800, "evaluate_every": 300}
BENCHMARK = {
    "tasks": ["arm"],
    "methods": ["dropo"],
    "seeds": [0],
    "preset": "smoke",
    "training": TRAINING,
}
SPARE = {"task": "arm", "method": "prior", "seed": 99, "preset": "smoke", "training": TRAINING}
RUNS = 7  # of which a scenario sees the end: six of the benchmark, and the spare one
RECORDING = recording("arm", 100, [1.2, 0.6, 2.0, 1.0]).to_npz()


def test_after_any_death_the_same_bytes_and_no_stage_lost_or_committed_twice(tmp_path_factory):
    folder = tmp_path_factory.mktemp("whole")
    with start_service(folder, cpus=1, environment={"ADR_FAILPOINT": "list"}) as running:
        table = everything(running.client)
        passed = re.findall(r"failpoint (\S+)", running.log.read_text())
    # these are passed at any time, and change nothing that anybody asks for
    besides = ("readyz:", "reclaim:")
    names = [name for name in dict.fromkeys(passed) if not name.startswith(besides)]
    assert "migration_0001" in names
    stages = committed(folder)
    assert len(names) > 20
    deaths = lost = twice = 0
    folders = [tmp_path_factory.mktemp("faulty") for _ in names]
    with ThreadPoolExecutor(2) as pool:  # services of one core each
        found = pool.map(with_a_death, folders, names, repeat(table))
        for name, folder, (died, gone, again) in zip(names, folders, found, strict=True):
            report(f"{name}: {'died' if died else 'was not reached'}")
            deaths += died
            lost += gone + len(stages - committed(folder))
            twice += again
    report(f"faults injected {deaths} of {len(names)}, runs completed {(deaths + 1) * RUNS}")
    report(f"stages lost {lost}, stages committed twice {twice}")
    assert (lost, twice) == (0, 0)
    # whether a training is noted before it has finished is a matter of time
    assert deaths >= len(names) - 2


def report(line: str) -> None:
    sys.stderr.write(f"{line}\n")


def with_a_death(folder: Path, failpoint: str, table: str) -> tuple[bool, int, int]:
    """Let the service die at a failpoint, and start it again.

    Returns whether it died there; how many stages are finished on a run's record without a stored
    result; and how many stages it computed again in spite of a stored result.
    """
    try:
        with start_service(folder, cpus=1, environment={"ADR_FAILPOINT": failpoint}) as running:
            try:
                assert everything(running.client) == table
            except Unreachable:
                assert running.process.wait(timeout=30) == 137
            else:
                return False, 0, 0
    except NotStarted as death:
        if death.status != 137:
            raise
    stored, recorded = committed(folder), finished(folder)
    with start_service(folder, cpus=1) as running:
        assert everything(running.client) == table
        again = len(stored & set(running.started_stages))
    return True, len(recorded - stored), again


def everything(client: AdrClient) -> str:
    """Make every kind of request, as far as it was not made before; return the result table."""
    dataset = client.upload(RECORDING, "arm")["id"]
    known = client.list_all("benchmarks")
    benchmark = (known[0] if known else client.submit_benchmark(BENCHMARK))["id"]
    if client.get(benchmark)["spec"]["seeds"] == BENCHMARK["seeds"]:
        client.extend_benchmark(benchmark, {"seeds": [1]})
    prior = client.list_all("runs", method="prior")
    spare = [run for run in prior if run["spec"]["seed"] == SPARE["seed"]]
    run = (spare[0] if spare else client.submit_run(SPARE))["id"]
    if client.get(run)["state"] in ("queued", "running"):
        client.cancel(run)
    assert wait_until_finished(client, benchmark, 600)["states"] == {"succeeded": RUNS - 1}
    table = client.results_csv(benchmark)
    if wait_until_finished(client, run, 300)["state"] == "cancelled":
        client.resume(run)
        assert wait_until_finished(client, run, 300)["state"] == "succeeded"
    client.delete(run)
    client.delete(dataset)
    return table


def has_tables(database: sqlite3.Connection) -> bool:
    """True if the service had made its tables before it died."""
    return bool(database.execute("select 1 from sqlite_master where name = 'stages'").fetchone())


def finished(folder: Path) -> set[str]:
    """Digests of the stages whose end is on the record of some run."""
    with closing(sqlite3.connect(folder / "adr.sqlite")) as database:
        if not has_tables(database):
            return set()
        bodies = database.execute("select body from events where type = 'stage_finished'")
        return {json.loads(body)["digest"] for (body,) in bodies}


def committed(folder: Path) -> set[str]:
    """Digests of the stages on disk."""
    with closing(sqlite3.connect(folder / "adr.sqlite")) as database:
        assert database.execute("pragma integrity_check").fetchone() == ("ok",)
        if not has_tables(database):
            return set()
        return {digest for (digest,) in database.execute("select digest from stages")}
