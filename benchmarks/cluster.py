"""Stages per second that the service keeps up with.

    python -m benchmarks.cluster [seconds per row, 20]

The dispatcher and the database are real; the cluster is not: its processes give a stand-in result
at once, or after up to four seconds. So the numbers are what the service itself can do, beside 64
runs that ask for stages from threads. Half of the stages are trainings, each with a policy of
50 kB, and half are evaluations, which are claimed before and completed after.

Columns: stages per second and per CPU second of the process, runs included; latency from the end
of a stage to the moment when its run has the stored result; CPU, and peak memory of the process.
Stages per CPU second say most where other programs use the machine as well. The rows of PostgreSQL
need Debian's package.
"""

import itertools
import logging
import resource
import statistics
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from contextlib import ExitStack, closing, contextmanager
from dataclasses import replace
from datetime import UTC, datetime
from multiprocessing import get_context
from types import SimpleNamespace
from typing import Any
from unittest.mock import patch

import numpy as np
import pytest
import ray
from sqlalchemy import insert

from adr_service.benchmark.cost import Execution
from adr_service.errors import RunCancelled
from adr_service.events import StageFinished
from adr_service.json_values import canonical_json, sha256
from adr_service.programs.references import reference_training
from adr_service.specs import RunSpec
from adr_service.stages.base import AnyStage, StageResult
from adr_service.stages.evaluate import Evaluate
from db.models import ArtifactRow, EventRow, StageArtifactRow, StageRow
from db.runs import create_run
from db.session import Database, open_database
from tests.postgresql import start_server
from workers.actors import Finished
from workers.cluster import ClusterUnavailable, RayOptions
from workers.dispatcher import Dispatcher
from workers.heartbeats import Board
from workers.ray_stages import RayStages
from workers.results import DatabaseResults

RUNS = 64
SPEC = RunSpec.model_validate({"task": "arm", "method": "prior", "preset": "smoke"})
TRAINING = reference_training(SPEC)
POLICY_BYTES = 50_000
SLOTS, STORED, SLOWEST_S = (200, 1000), (1_000, 100_000), (0.0, 4.0)


def main() -> None:
    seconds = float(sys.argv[1]) if len(sys.argv) > 1 else 20.0
    print("database     stored   slots  stage [s]    per s  per CPU s  p50 [s]   p95  CPU    [MB]")
    with databases() as kinds:
        for kind, stored, slots, slowest in itertools.product(kinds, STORED, SLOTS, SLOWEST_S):
            given = kinds[kind](), stored, slots, slowest, seconds
            with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as process:
                row = process.submit(measured, *given).result()
            print(f"{kind:10} {stored:8} {slots:7} {row}", flush=True)


def measured(url: str, stored: int, slots: int, slowest_s: float, seconds: float) -> str:
    """One row, in a process and on a database of its own: a peak of memory never falls again."""
    logging.disable(logging.WARNING)
    with closing(open_database(url)) as database:
        fill(database, stored)
        return Measurement(database, slots, slowest_s).measure(seconds)


@contextmanager
def databases() -> Iterator[Mapping[str, Callable[[], str]]]:
    """Functions that return the URL of a new database, by kind."""
    with ExitStack() as stack:
        folder = stack.enter_context(tempfile.TemporaryDirectory(prefix="adr-bench-"))
        numbers = itertools.count()
        kinds = {"SQLite": lambda: f"sqlite:///{folder}/{next(numbers)}.sqlite"}
        try:
            kinds["PostgreSQL"] = stack.enter_context(start_server()).new_database
        except pytest.skip.Exception as reason:
            print(f"no rows of PostgreSQL: {reason}")
        yield kinds


def fill(database: Database, count: int) -> None:
    """Store results of stages that some run has had."""
    run_id, now = create_run(database, SPEC).id, datetime.now(UTC)
    document, result = (
        canonical_json(TRAINING.document),
        canonical_json(TRAINING.stand_in().to_stored().values),
    )
    for first in range(0, count, 1000):
        digests = [sha256(f"stored {number}".encode()) for number in range(first, first + 1000)]
        origin = {"attempt": 1, "started_by": run_id, "seconds": 1.0, "provenance": "{}"}
        stage = {"kind": TRAINING.kind, "document": document, "result": result, **origin}
        event = {"run_id": run_id, "type": "stage_finished", "body": "{}", "created_at": now}
        policy = {"size": 1000, "content": bytes(1000)}  # a disk has no room for real ones
        with database.write("fill") as session:
            session.execute(
                insert(StageRow), [{**stage, "digest": d, "created_at": now} for d in digests]
            )
            session.execute(
                insert(EventRow),
                [
                    {**event, "seq": first + number, "key": f"stage_finished:{digest}"}
                    for number, digest in enumerate(digests, 2)
                ],
            )
            session.execute(insert(ArtifactRow), [{**policy, "sha256": d} for d in digests])
            session.execute(
                insert(StageArtifactRow),
                [{"digest": d, "name": "policy", "sha256": d} for d in digests],
            )


class Ref:
    """The answer to a call, from a moment on."""

    def __init__(self, due: float, answer: Callable[[], Any]):
        self.due, self.answer = due, answer


class InstantRay:
    """The functions of the module `ray` that the dispatcher uses, without any process."""

    def __init__(self, slots: int, slowest_s: float):
        self._slots, self.slowest_s = slots, slowest_s
        self._rng = np.random.default_rng(0)
        self.ended: dict[str, float] = {}  # moments by digest

    @contextmanager
    def in_place(self) -> Iterator[None]:
        names = ("wait", "get", "kill", "nodes", "remote", "get_runtime_context")
        with patch.multiple(ray, **{name: getattr(self, name) for name in names}):
            yield

    def wait(
        self, refs: Sequence[Ref], num_returns: int = 1, timeout: float = 0.0
    ) -> tuple[list[Ref], list[Ref]]:
        """As Ray does, whose promise is to return once `num_returns` are there."""
        enough = sorted(ref.due for ref in refs)[num_returns - 1]
        time.sleep(max(0.0, min(timeout, enough - time.monotonic())))
        now = time.monotonic()
        return [ref for ref in refs if ref.due <= now], [ref for ref in refs if ref.due > now]

    def get(self, ref: Ref) -> Any:
        return ref.answer()

    def kill(self, handle: Any, no_restart: bool = True) -> None: ...

    def nodes(self) -> list[dict[str, Any]]:
        return [{"NodeID": "0" * 56, "Alive": True, "Resources": {"CPU": self._slots}}]

    def get_runtime_context(self) -> Any:
        return SimpleNamespace(get_node_id=lambda: "0" * 56)

    def remote(self, kind: type) -> Any:
        handle = self._board() if kind is Board else self._process()
        return SimpleNamespace(options=lambda **_: SimpleNamespace(remote=lambda: handle))

    def _board(self) -> Any:
        signs = SimpleNamespace(remote=lambda unwanted: Ref(0.0, lambda: ([], {})))
        return SimpleNamespace(news=signs)

    def _process(self) -> Any:
        return SimpleNamespace(compute=SimpleNamespace(remote=self._compute))

    def _compute(self, stage: AnyStage, placed: Execution, board: Any) -> Ref:
        seconds = self.slowest_s * self._rng.random()
        due = time.monotonic() + seconds
        self.ended[stage.digest] = due
        measured = {"cpu": seconds, "preparing": 0.0, "is_first": False}
        execution = replace(placed, ended=placed.began + seconds, **measured)
        return Ref(due, lambda: Finished(result_of(stage), execution))


def result_of(stage: AnyStage) -> StageResult:
    """A result as large as a real one."""
    result = stage.stand_in().to_stored()
    if stage.kind == TRAINING.kind:
        result.blobs["policy"] = stage.digest.encode() * (POLICY_BYTES // len(stage.digest))
    return result


class InstantCluster:
    """The `Cluster` of a dispatcher, which is there."""

    is_local, is_alive, dashboard_url = False, True, None

    def start(self) -> None: ...

    def close(self) -> None: ...


class Measurement:
    """A service on a cluster, and the runs that keep it busy."""

    def __init__(self, database: Database, slots: int, slowest_s: float):
        self._database, self._slots = database, slots
        self._ray = InstantRay(slots, slowest_s)
        self._latencies: list[float] = []
        self._stop = threading.Event()
        self._seeds = itertools.count(time.time_ns())

    def measure(self, seconds: float) -> str:
        """One row of the table, from the first stored result on."""
        runs = [create_run(self._database, SPEC).id for _ in range(RUNS)]
        with self._ray.in_place():
            results = DatabaseResults(self._database)
            dispatcher = Dispatcher(RayOptions(), results, lambda _: InstantCluster())
            dispatcher.start()
            threads = [threading.Thread(target=self._run, args=(dispatcher, id)) for id in runs]
            for thread in threads:
                thread.start()
            while not self._latencies:
                time.sleep(0.1)
            self._latencies.clear()
            began, used = time.monotonic(), time.process_time()
            time.sleep(seconds)
            took, used = time.monotonic() - began, time.process_time() - used
            latencies = list(self._latencies)
            self._stop.set()
            dispatcher.close()
            for thread in threads:
                thread.join()
        count, cuts = len(latencies), statistics.quantiles(latencies, n=20)
        memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e3
        return (
            f"{self._ray.slowest_s:10.0f} {count / took:8.0f} {count / used:10.0f} "
            f"{cuts[9]:8.2f} {cuts[18]:5.2f} {used / took:4.0%} {memory:7.0f}"
        )

    def _run(self, dispatcher: Dispatcher, run_id: str) -> None:
        """Ask for stages, twice as many as the run's share of the slots, until the end."""
        stages = RayStages(run_id, dispatcher, self._stop.is_set)
        try:
            while True:
                asked = [self._new_stage() for _ in range(2 * self._slots // RUNS)]
                for event in stages.all(asked):
                    if isinstance(event, StageFinished):
                        self._latencies.append(time.monotonic() - self._ray.ended[event.digest])
        except (RunCancelled, ClusterUnavailable):
            return

    def _new_stage(self) -> AnyStage:
        seed = next(self._seeds)
        if seed % 2:
            return replace(TRAINING, seed=seed)
        policy = TRAINING.digest.encode()
        return Evaluate(task="arm", variant="vanilla", episodes=50, seed=seed, policy=policy)


if __name__ == "__main__":
    main()
