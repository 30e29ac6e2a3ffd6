"""Soak test: each part of the service is killed at random moments under 2,000 stages of many runs.

The service, its database, Ray's processes, the workers and the robots die, and robots stop for
longer than a lease. All results are, to the byte, those of a service that nothing disturbs, and
the robots' leases were exclusive.
"""

import itertools
import re
import signal
import sys
import time
from collections import Counter
from collections.abc import Callable, Mapping
from contextlib import ExitStack
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from sqlalchemy import select

from adr_service.client import AdrClient, Refused, Unreachable, is_finished
from db.models import StageArtifactRow, StageRow, TargetTaskRow
from db.session import open_database
from tests.acceptance.lease_history import Request, read_history, violations
from tests.acceptance.supervised import Supervised, SupervisedService
from tests.postgresql import Server
from tests.service import attempts_in, start_service, until, wait_until_finished

pytestmark = [pytest.mark.ray, pytest.mark.slow]
SEED = 0
STAGES = 2000
BETWEEN_S = (5.0, 40.0)  # from one death to the next
LEASE_S = 3.0
SLEEP_S = 3 * LEASE_S
ENVIRONMENT = {"ADR_LEASE_S": str(LEASE_S)}
TINY = {
    "preset": "smoke",
    "iterations": 5,
    "training": {"max_steps": 200, "evaluate_every": 100},
}
BENCHMARK = {
    **TINY,
    "tasks": ["arm"],
    "variants": ["vanilla", "noisy", "unmodeled"],
    "methods": ["simopt", "dropo", "sysid"],
    "seeds": [*range(12)],
}
# episodes of six seconds at the robots' pace
BY_ROBOTS = {
    **TINY,
    "task": "arm",
    "method": "simopt",
    "transitions": 200,
    "evaluation_episodes": 2,
    "target": {"kind": "external"},
}
ROBOT_RUNS, ROBOTS = 12, 3


def test_whatever_dies_results_are_the_same_and_leases_exclusive(tmp_path, postgresql):
    quiet, soaked = tmp_path / "quiet", tmp_path / "soaked"
    for folder in (quiet, soaked):
        folder.mkdir(mode=0o700)
    tables = undisturbed(quiet)
    url, began = postgresql.new_database(), time.monotonic()
    killed, log, histories = disturbed(soaked, url, postgresql, tables)
    history = read_history(histories)
    stages, visits = stages_in(url), visits_in(url)
    begun = Counter(Counter(digest for digest, _ in attempts_in(log)).values())
    unknown = sum(request.is_unknown for request in history)
    lost = sum(request.status == 409 for request in history)
    sys.stderr.write(
        f"seed {SEED}: {len(stages)} stages in {(time.monotonic() - began) / 60:.0f} minutes; "
        f"killed {dict(killed)}; stages begun once, twice, …: {dict(sorted(begun.items()))}; "
        f"{len(visits)} tasks of robots, {sum(visit.attempt for visit in visits)} leases, "
        f"{len(history)} requests, {unknown} without an answer and {lost} under a lost lease\n"
    )
    assert len(stages) >= STAGES
    assert all(killed.values())
    assert max(begun) > 1, "no stage was lost"
    assert any(visit.attempt > 1 for visit in visits), "no lease was lost"
    assert lost, "nobody request under a lost lease"
    assert stages == stages_in(f"sqlite:///{quiet / 'adr.sqlite'}")
    assert violations(history, LEASE_S) == []
    assert contradictions(visits, history) == []


def undisturbed(folder: Path) -> list[str]:
    """The result tables of a service on SQLite, where nothing dies."""
    with start_service(folder, cpus=2, environment=ENVIRONMENT) as running, ExitStack() as stack:
        robots(stack, running.client.url, folder)
        ids = submit(running.client)
        for id in ids:
            wait_until_finished(running.client, id, 3600)
        return [running.client.results_csv(id) for id in ids]


def disturbed(
    folder: Path, url: str, server: Server, tables: list[str]
) -> tuple[Counter[str], Path, list[Path]]:
    """Compute the same where everything dies; deaths by name, the service's log and histories."""
    rng = np.random.default_rng(SEED)
    with ExitStack() as stack:
        environment = {**ENVIRONMENT, "ADR_DATABASE_URL": url}
        service = stack.enter_context(SupervisedService(folder, environment))
        client = stack.enter_context(AdrClient(service.url, timeout_s=10))
        until(lambda: answered(client.ready))
        at_work = robots(stack, service.url, folder)
        ids = submit(client)
        killed = disturb(ways_to_kill(service, at_work, server, rng), client, ids, rng)
        for id, table in zip(ids, tables, strict=True):
            seen = client.get(id)
            assert set(seen.get("states", [seen.get("state")])) == {"succeeded"}, seen
            assert client.results_csv(id) == table
        return killed, service.log, [robot.history for robot in at_work]


def submit(client: AdrClient) -> list[str]:
    runs = [client.submit_run({**BY_ROBOTS, "seed": seed}) for seed in range(ROBOT_RUNS)]
    return [client.submit_benchmark(BENCHMARK)["id"], *(run["id"] for run in runs)]


class RecordedRobot(Supervised):
    def __init__(self, url: str, folder: Path, number: int):
        self.history = folder / f"robot-{number}.jsonl"
        command = [sys.executable, "-m", "tests.acceptance.recorded_robot", url, self.history]
        super().__init__(command, folder / f"robot-{number}.log", {})


def robots(stack: ExitStack, url: str, folder: Path) -> list[RecordedRobot]:
    made = [RecordedRobot(url, folder, number) for number in range(ROBOTS)]
    return [stack.enter_context(robot) for robot in made]


def disturb(
    kills: Mapping[str, Callable[[], bool]],
    client: AdrClient,
    ids: list[str],
    rng: np.random.Generator,
) -> Counter[str]:
    """Kill one thing after the other until all runs have finished; how often each was killed."""
    killed = Counter(dict.fromkeys(kills, 0))

    def finished_within(seconds: float) -> bool:
        deadline = time.monotonic() + seconds
        while time.monotonic() < deadline:
            if answered(lambda: all(is_finished(client.get(id)) for id in ids)):
                return True
            time.sleep(min(1.0, seconds))
        return False

    for name in itertools.chain.from_iterable(rng.permutation([*kills]) for _ in itertools.count()):
        if finished_within(rng.uniform(*BETWEEN_S)):
            break
        while not kills[name]():  # it starts just now
            if finished_within(0.1):
                return killed
        killed[name] += 1
    return killed


def ways_to_kill(
    service: SupervisedService,
    at_work: list[RecordedRobot],
    server: Server,
    rng: np.random.Generator,
) -> dict[str, Callable[[], bool]]:
    """Functions that kill one part each, by name; False if it was not there."""

    def one() -> RecordedRobot:
        return at_work[rng.integers(len(at_work))]

    def kill_database() -> bool:
        server.kill()
        time.sleep(rng.uniform(0, 5))
        server.start()
        return True

    def send_to_sleep() -> bool:
        robot = one()
        slept = robot.signal(signal.SIGSTOP)
        time.sleep(SLEEP_S)
        robot.signal(signal.SIGCONT)
        return slept

    return {
        "service": lambda: service.signal(signal.SIGKILL),
        "database": kill_database,
        "GCS": partial(service.kill_child, "gcs/gcs_server"),
        "raylet": partial(service.kill_child, "raylet/raylet"),
        "board": partial(service.kill_child, "ray::Board"),
        "worker": partial(service.kill_child, "ray::StageActor.compute"),
        "robot": lambda: one().signal(signal.SIGKILL),
        "sleeping robot": send_to_sleep,
    }


def answered(ask: Callable[[], object]) -> object:
    """The answer; False if the service gives none now."""
    try:
        return ask()
    except (Refused, Unreachable):
        return False


def stages_in(url: str) -> dict[str, tuple[str, dict[str, str]]]:
    """Every stage's result and its blobs' hashes, by its document without ids of runs.

    A robot's episode belongs to one run, whose id no other service gives.
    """
    database = open_database(url)
    with database.read() as session:
        rows = session.execute(select(StageRow.digest, StageRow.document, StageRow.result)).all()
        blobs: dict[str, dict[str, str]] = {digest: {} for digest, _, _ in rows}
        for blob in session.scalars(select(StageArtifactRow)):
            blobs[blob.digest][blob.name] = blob.sha256
    database.close()
    found = {
        re.sub(r'"run":"run_\w+"', '"run":""', document): (result, blobs[digest])
        for digest, document, result in rows
    }
    assert len(found) == len(rows)
    return found


def visits_in(url: str) -> list[TargetTaskRow]:
    """The robots' tasks."""
    database = open_database(url)
    with database.read() as session:
        visits = list(session.scalars(select(TargetTaskRow).where(TargetTaskRow.external)))
        session.expunge_all()
    database.close()
    return visits


def contradictions(visits: list[TargetTaskRow], history: list[Request]) -> list[str]:
    """Contradictions between tasks, as they are stored, and the robots' history."""
    claims = [request for request in history if request.kind == "claim"]
    heard = Counter(claim.visit for claim in claims if claim.lease)
    found = [f"{visit.id} is {visit.state}" for visit in visits if visit.state != "done"]
    unheard = {visit.id: visit.attempt - heard[visit.id] for visit in visits}
    found += [f"{id} has fewer claims than were answered" for id, n in unheard.items() if n < 0]
    if sum(unheard.values()) > sum(claim.is_unknown for claim in claims):
        found.append(f"more leases than robots can have been given: {unheard}")
    accepted = [r for r in history if r.kind == "trajectory" and r.is_accepted]
    stored = {(visit.id, visit.lease) for visit in visits}
    found += [
        f"{request.visit} has the result of another lease than was accepted"
        for request in accepted
        if (request.visit, request.lease) not in stored
    ]
    return found
