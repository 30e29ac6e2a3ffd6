"""How fast the service answers: on a full database, and under load while both cores train.

    python benchmarks/load.py [seconds of load, 60] [runs in the database, 10000]

The database gets 100 events per run, in benchmarks of 96 runs and single ones. Every benchmark's
results are asked for once, which computes them; they are kept. Then, first, every route is asked 50
times, one after the other, of a service that does nothing else. Second, while a benchmark trains on
two cores, 50 clients ask every .5 to 1.5 s each for what a person or `adr watch` asks, and 5 submit
a run a second each (a 429 with Retry-After is no error; they wait and go on). The clients are one
process of coroutines, the service with Ray another.

Writes build/bench/api.json, route -> {p50_ms, p95_ms, p99_ms, errors, requests} under load, and
api-full.json, the same of the first part; prints whether every accepted run is in the database.
"""

import asyncio
import json
import os
import shutil
import sqlite3
import statistics
import sys
import time
from collections import defaultdict
from collections.abc import Sequence
from contextlib import closing
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import httpx2
import numpy as np

from adr_service.client import AdrClient
from adr_service.distributions import Gaussian, Uniform
from adr_service.events import (
    IterationFinished,
    RunEvent,
    RunQueued,
    RunStarted,
    RunSucceeded,
    StageFinished,
    TrainingEvaluated,
)
from adr_service.json_values import sha256
from adr_service.programs.references import truth_of
from adr_service.specs import BenchmarkSpec, RunSpec
from adr_service.tasks.catalogue import source_of
from api.cli.own_service import own_service
from api.cli.ports import free_port
from db.session import open_database

FOLDER = Path("build/bench")
EVENTS = 100  # per run
READERS, WRITERS = 50, 5
TARGET_MS = 100.0
GRID = {
    "tasks": ["arm"],
    "variants": ["vanilla", "noisy", "unmodeled"],
    "methods": ["udr", "bayrn", "simopt", "simopt_1", "droid", "dropo"],
    "seeds": [0, 1, 2, 3],
    "preset": "demo",
}
TRAINING = {
    "tasks": ["hopper"],
    "methods": ["udr"],
    "seeds": [0],
    "preset": "quick",
    "training": {"max_steps": 5_000_000, "stop_at_threshold": False},
}
SUBMITTED = {"task": "arm", "method": "dropo", "preset": "smoke", "collector": "random"}
Found = dict[str, dict[str, float]]


def main() -> None:
    seconds = float(sys.argv[1]) if len(sys.argv) > 1 else 60.0
    runs = int(sys.argv[2]) if len(sys.argv) > 2 else 10_000
    data = FOLDER / "api"
    shutil.rmtree(data, ignore_errors=True)
    data.mkdir(parents=True)
    started = time.monotonic()
    ids, benchmarks = fill(data / "adr.sqlite", runs)
    size = (data / "adr.sqlite").stat().st_size / 1e6
    print(
        f"{runs} runs, {runs * EVENTS} events, {size:.0f} MB, in {time.monotonic() - started:.0f} s"
    )
    os.environ |= {"ADR_CPUS": "2", "ADR_DASHBOARD": "false", "OMP_NUM_THREADS": "1"}
    with own_service(data, free_port()) as client:
        first = compute_results(client.url, benchmarks)
        print(f"results of a benchmark of 96 runs, when they are asked for first: {first:.1f} s")
        quiet = full(client.url, ids, benchmarks)
        show("a full database", quiet)
        training = client.submit_benchmark(TRAINING)["id"]
        wait_for_training(client, training)
        loaded, accepted = asyncio.run(load(client.url, seconds, ids, benchmarks))
        show(f"{READERS} readers and {WRITERS} writers while two cores train", loaded)
        submitted = client.list_all("runs", method="dropo", task="arm")
        lost = accepted - {run["id"] for run in submitted}
    print(f"accepted {len(accepted)} runs, lost {len(lost)}")
    (FOLDER / "api.json").write_text(json.dumps(loaded, indent=1))
    (FOLDER / "api-full.json").write_text(json.dumps(quiet, indent=1))


def fill(path: Path, count: int) -> tuple[list[str], list[str]]:
    """A database of `count` finished runs; ids of some runs, and of the benchmarks."""
    open_database(f"sqlite:///{path}").close()
    now = datetime.now(UTC).strftime("%Y-%m-%d %H:%M:%S.%f")
    grid = BenchmarkSpec.model_validate(GRID)
    specs = list(grid.runs())
    stories = [story(spec) for spec in specs]
    ids: list[str] = []
    with closing(sqlite3.connect(path)) as database, database:
        benchmarks: list[str] = []
        for number in range(count):
            which = number % (len(specs) + 4)  # four single runs after each benchmark
            if which == 0:
                benchmarks.append(f"bench_{len(benchmarks):016x}")
                given = grid.model_dump_json(exclude_unset=True)
                database.execute(
                    "insert into benchmarks (id, created_at, spec) values (?, ?, ?)",
                    (benchmarks[-1], now, given),
                )
            single = which >= len(specs)
            spec, events = specs[which % len(specs)], stories[which % len(specs)]
            ids.append(f"run_{number:016x}")
            database.execute(
                "insert into runs (id, benchmark_id, created_at, updated_at, task, variant, method,"
                " seed, spec, state, submission, cancel_requested) values (?, ?, ?, ?, ?, ?, ?, ?,"
                " ?, 'succeeded', 1, 0)",
                (
                    *(ids[-1], None if single else benchmarks[-1], now, now),
                    *(spec.task, spec.variant, spec.method.name, spec.seed),
                    spec.model_dump_json(),
                ),
            )
            rows = ((ids[-1], seq, *event, now) for seq, event in enumerate(events, 1))
            database.executemany("insert into events values (?, ?, ?, ?, ?, ?)", rows)
    whole = benchmarks[: count // (len(specs) + 4)]  # the last may lack runs
    return ids, whole


def story(spec: RunSpec) -> list[tuple[str, str, str]]:
    """(key, type, body) of the events of a finished run."""
    rng = np.random.default_rng(spec.seed)
    policies = getattr(spec.method, "policies", 1)
    iterations = 1 if spec.method.learns_from == "nothing" else spec.iterations + 1
    events: list[RunEvent] = [RunQueued(submission=1), RunStarted(submission=1)]
    space = source_of(spec.task, spec.variant).space
    belief = Gaussian.prior(space).to_json()
    if not spec.method.believes:
        belief = Uniform(space, space.low, space.high).to_json()
    if spec.method.needs_truth:
        belief = truth_of(spec.task, spec.variant).to_json()
    for iteration in range(iterations):
        digest = sha256(f"{spec.method.name} {spec.seed} {iteration}".encode())
        events.append(StageFinished(kind="train_policy", digest=digest))
        events.append(
            IterationFinished(
                iteration=iteration,
                target_rollouts=iteration,
                target_transitions=200 * iteration,
                evaluation_episodes=50 * policies,
                distributions=[belief] * policies,
                policies=[digest] * policies,
                source_returns=[1.0] * policies,
                reached_threshold=[True] * policies,
                training_steps=[1000] * policies,
                inference_steps=1000,
                returns=[[float(rng.normal(100, 10)) for _ in range(50)] for _ in range(policies)],
                diagnostics={"mean_squared_error": 1e-5, "epsilon": 1e-3},
            )
        )
    digest = sha256(f"{spec.method.name} {spec.seed}".encode())
    for step in range(EVENTS - len(events) - 1):
        point = {"steps": 1000 * step, "mean_return": 10.0 * step, "standard_error": 1.0}
        events.append(TrainingEvaluated(digest=digest, **point))
    events.append(RunSucceeded())
    return [(event.key, event.type, event.model_dump_json()) for event in events]


def wait_for_training(client: AdrClient, benchmark: str) -> None:
    """Until two trainings are past their compilation."""
    while True:
        progress = [s for run in client.get(benchmark)["runs"] for s in run["progress"]]
        if sum(s["kind"] == "train_policy" and s["fraction"] > 0 for s in progress) >= 2:
            return
        time.sleep(1)


def routes(
    ids: Sequence[str], benchmarks: Sequence[str], rng: np.random.Generator
) -> dict[str, str]:
    """Paths of the requests, by the name of the route."""
    run, benchmark = ids[rng.integers(len(ids))], benchmarks[rng.integers(len(benchmarks))]
    return {
        "GET /v1/runs": "/v1/runs",
        "GET /v1/runs, a later page": f"/v1/runs?page_token={rng.integers(len(ids))}",
        "GET /v1/runs, by state": "/v1/runs?state=running",
        "GET /v1/runs, by method and task": "/v1/runs?method=dropo&task=arm",
        "GET /v1/runs, of a task without runs": "/v1/runs?task=walker2d",
        "GET /v1/runs/{id}": f"/v1/runs/{run}",
        "GET /v1/runs/{id}/events": f"/v1/runs/{run}/events",
        "GET /v1/runs/{id}/results": f"/v1/runs/{run}/results",
        "GET /v1/benchmarks/{id}": f"/v1/benchmarks/{benchmark}",
        "GET /v1/benchmarks/{id}/results": f"/v1/benchmarks/{benchmark}/results",
        "GET /v1/benchmarks": "/v1/benchmarks?page_size=10",
        "GET /v1/target_tasks": "/v1/target_tasks?state=pending",
        "GET /readyz": "/readyz",
    }


def compute_results(url: str, benchmarks: Sequence[str]) -> float:
    """Ask for each result table once; what they took, median in s. They are kept from then on."""
    took: list[float] = []
    with httpx2.Client(base_url=url, timeout=60) as http:
        for id in benchmarks:
            started = time.perf_counter()
            http.get(f"/v1/benchmarks/{id}/results").raise_for_status()
            took.append(time.perf_counter() - started)
    return statistics.median(took)


def full(url: str, ids: Sequence[str], benchmarks: Sequence[str]) -> Found:
    took: dict[str, list[float]] = defaultdict(list)
    errors: dict[str, int] = defaultdict(int)
    rng = np.random.default_rng(0)
    with httpx2.Client(base_url=url, timeout=60) as http:
        for _ in range(50):
            for name, path in routes(ids, benchmarks, rng).items():
                started = time.perf_counter()
                answer = http.get(path)
                took[name].append(1000 * (time.perf_counter() - started))
                errors[name] += answer.status_code != 200
    return summary(took, errors)


async def load(
    url: str, seconds: float, ids: Sequence[str], benchmarks: Sequence[str]
) -> tuple[Found, set[str]]:
    took: dict[str, list[float]] = defaultdict(list)
    errors: dict[str, int] = defaultdict(int)
    accepted: set[str] = set()
    until = time.monotonic() + seconds
    limits = httpx2.Limits(max_connections=READERS + WRITERS)

    async def ask(http: httpx2.AsyncClient, name: str, method: str, path: str, **more: Any) -> Any:
        started = time.perf_counter()
        try:
            answer = await http.request(method, path, **more)
        except httpx2.HTTPError as error:
            errors[name] += 1
            print(f"{name}: {error!r}")
            return None
        took[name].append(1000 * (time.perf_counter() - started))
        if answer.status_code == 429 and "Retry-After" in answer.headers:
            await asyncio.sleep(float(answer.headers["Retry-After"]))
            return None
        if answer.is_error:
            errors[name] += 1
            print(f"{name}: {answer.status_code} {answer.text[:200]}")
        return answer

    async def read(http: httpx2.AsyncClient, seed: int) -> None:
        rng = np.random.default_rng(seed)
        await asyncio.sleep(rng.random())
        while time.monotonic() < until:
            asked = list(routes(ids, benchmarks, rng).items())
            name, path = asked[rng.integers(len(asked))]
            await ask(http, name, "GET", path)
            await asyncio.sleep(rng.uniform(0.5, 1.5))  # in step, all would wait for each other

    async def write(http: httpx2.AsyncClient, number: int) -> None:
        seed = 100_000 * (number + 1)
        while time.monotonic() < until:
            seed += 1
            answer = await ask(
                http, "POST /v1/runs", "POST", "/v1/runs", json={**SUBMITTED, "seed": seed}
            )
            if answer is not None and answer.status_code == 202:
                accepted.add(answer.json()["id"])
            await asyncio.sleep(1.0)

    async with httpx2.AsyncClient(base_url=url, timeout=60, limits=limits) as http:
        readers = (read(http, seed) for seed in range(READERS))
        await asyncio.gather(*readers, *(write(http, number) for number in range(WRITERS)))
    return summary(took, errors), accepted


def summary(took: dict[str, list[float]], errors: dict[str, int]) -> Found:
    found: Found = {}
    for name, times in sorted(took.items()):
        cuts = (
            statistics.quantiles(times, n=100, method="inclusive") if len(times) > 1 else times * 99
        )
        found[name] = {
            "p50_ms": round(cuts[49], 1),
            "p95_ms": round(cuts[94], 1),
            "p99_ms": round(cuts[98], 1),
            "errors": errors[name],
            "requests": len(times),
        }
    return found


def show(title: str, found: Found) -> None:
    print(title)
    for name, row in found.items():
        missed = "" if row["p99_ms"] < TARGET_MS or name.startswith("POST") else "  MISSED"
        numbers = " ".join(f"{key} {value:7g}" for key, value in row.items())
        print(f"  {name:40} {numbers}{missed}")


if __name__ == "__main__":
    main()
