"""Checks that the parts of an archive belong together.

    for checked in replays(archived):        # InvalidInput where they do not
        print(checked.id, checked.is_verified)

Digests are computed again from the stages' documents, rows of runs from their specs and events,
and events from the stages' results. The results themselves are as true as their source:
`adr_service.benchmark.verification` computes some of them again.
"""

import json
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from math import isfinite
from typing import Any, cast

from pydantic import ValidationError
from sqlalchemy import select
from sqlalchemy.orm import Session

from adr_service.benchmark.replay import Replay, replay_run
from adr_service.errors import InvalidInput
from adr_service.events import (
    IterationFinished,
    RunEvent,
    RunFailed,
    RunQueued,
    RunStarted,
    RunState,
    RunStopped,
    RunSucceeded,
    StageFinished,
    event_from_json,
    state_after,
)
from adr_service.json_values import canonical_json, explain, sha256
from adr_service.plugins import PACKAGES
from adr_service.specs import MAX_RUNS, LostRun, RunSpec
from adr_service.specs.lost import Lost
from db.benchmarks import cell_of, list_benchmarks, readable
from db.errors import DatabaseDamaged
from db.models import EventRow, RunRow, StageRow
from db.runs import list_runs, new_run
from db.session import CHUNK, parts
from db.stages import (
    HAS_PACKAGE,
    find_result,
    has_unreferenced,
    is_readable,
    packages_in,
)
from db.staging import Staged

_RUN_ID, _BENCHMARK_ID = re.compile(r"run_[0-9a-f]{16}"), re.compile(r"bench_[0-9a-f]{16}")
_Lifecycle = RunQueued | RunStarted | RunSucceeded | RunFailed | RunStopped
_MOST_NAMED = 10
_LONGEST_EVENTS = 50_000_000  # characters of a run's events, which are read at once
_DERIVED = ("benchmark_id", "dataset_id", "task", "variant", "method", "seed")  # from the spec


@dataclass(frozen=True)
class CheckedRun:
    """A run of an archive, replayed over its results."""

    id: str
    replay: Replay
    is_verified: bool  # all its events were computed again


def replays(archived: Staged) -> Iterator[CheckedRun]:
    """Check an archive, and replay its runs one after the other. Raises InvalidInput."""
    database, id = archived.database, archived.manifest.benchmark
    try:
        benchmarks = list_benchmarks(database, limit=2)
        if [record.id for record in benchmarks] != [id] or not _BENCHMARK_ID.fullmatch(id):
            raise InvalidInput("an archive has one benchmark, the one that its manifest names")
        cells = {cell_of(run) for run in readable(benchmarks[0]).runs()}
        records = list_runs(database, limit=MAX_RUNS + 1)
        lost = [record.spec.reason for record in records if isinstance(record.spec, LostRun)]
        if lost:
            raise Lost(lost[0])
    except (DatabaseDamaged, Lost) as error:
        raise InvalidInput(
            f"the archive cannot be used here: {error}{_packages_of(archived)}"
        ) from error
    if not 0 < len(records) <= MAX_RUNS:
        given = "more" if records else "none"
        raise InvalidInput(f"an archive has 1 to {MAX_RUNS} runs; this one has {given}")
    with database.read() as session:
        _check_stages(session)
        for record in records:
            if not isinstance(record.spec, RunSpec) or cell_of(record.spec) not in cells:
                raise InvalidInput(f"{record.id} in the archive is no run of its benchmark")
            cells.remove(cell_of(record.spec))  # each cell has one run
            yield _replay(session, record.id, record.spec, id)


def _packages_of(archived: Staged) -> str:
    """Packages and their versions that stages of an archive name, for a message; it may be hostile,
    and nothing of it is checked yet."""
    query = select(StageRow.document).where(HAS_PACKAGE)
    with archived.database.read() as session:
        named = packages_in(session.scalars(query, execution_options={"yield_per": 100}))
    names = [" ".join(package) for package in sorted(named)[:_MOST_NAMED]]
    return f"; its stages are of {', '.join(names)}" if names else ""


def _check_stages(session: Session) -> None:
    for row in session.scalars(select(StageRow), execution_options={"yield_per": 100}):
        document = _object(row.document, row.digest)
        if sha256(row.document.encode()) != row.digest or document.get("kind") != row.kind:
            raise InvalidInput(f"stage {row.digest} in the archive has the document of another one")
        _object(row.result, row.digest)
        if not is_readable(row):
            raise InvalidInput(f"stage {row.digest} in the archive has an unreadable execution")
    if has_unreferenced(session):
        raise InvalidInput("the archive has stages of no run, or blobs of no stage")


def _replay(session: Session, run_id: str, spec: RunSpec, benchmark_id: str) -> CheckedRun:
    row = session.scalars(select(RunRow).where(RunRow.id == run_id)).one()
    events = _events(session, run_id)
    lifecycle = [event for event in events if isinstance(event, _Lifecycle)]
    is_its_own = _facts(row) == _expected(spec, benchmark_id, lifecycle)
    if not _RUN_ID.fullmatch(run_id) or not is_its_own or not _is_in_order(lifecycle):
        raise InvalidInput(f"the row of run {run_id} in the archive contradicts its spec or events")
    replay = replay_run(run_id, spec, lambda digest: find_result(session, digest))
    has_succeeded = row.state == RunState.SUCCEEDED
    if replay.broken and has_succeeded:
        raise InvalidInput(replay.broken)
    if _has_other_versions(session, events, replay):
        return CheckedRun(run_id, replay, is_verified=False)
    science = {event.key: event for event in events if not isinstance(event, _Lifecycle)}
    if wrong := replay.disagreements(science):
        raise InvalidInput(
            f"event {wrong[0]} of {run_id} in the archive does not follow from the stored results"
        )
    if replay.broken:
        return CheckedRun(run_id, replay, is_verified=False)
    if lacking := replay.lacking(science, has_succeeded):
        raise InvalidInput(
            f"the archive has no event {lacking[0]} of {run_id}, though its results lead to it"
        )
    is_whole = replay.is_complete or not has_succeeded
    return CheckedRun(run_id, replay, is_whole and not replay.is_behind(science))


def _has_other_versions(session: Session, events: Sequence[RunEvent], replay: Replay) -> bool:
    """True if the run has finished a stage of another version than its program asks for today.

    Its events follow from that, or from both. The results may all be there: the run went on with
    today's version, or another run of the benchmark did.
    """
    today: dict[str, set[str]] = {}
    for stage in replay.stages:
        today.setdefault(stage.kind, set()).add(_version(stage.document))
    mine = [event.digest for event in events if isinstance(event, StageFinished)]
    for some in parts(mine, CHUNK):
        query = select(StageRow.kind, StageRow.document).where(StageRow.digest.in_(some))
        for kind, document in session.execute(query):
            if kind in today and _version(json.loads(document)) not in today[kind]:
                return True
    return False


def _version(document: dict[str, Any]) -> str:
    """The version of a stage's kind, and the packages that its task and method come from."""
    inputs = document.get("inputs")
    given = cast(dict[str, Any], inputs) if isinstance(inputs, dict) else {}
    return canonical_json([document.get("version"), *(given.get(name) for name in PACKAGES)])


def _events(session: Session, run_id: str) -> list[RunEvent]:
    """The events of a run, in order."""
    mine = select(EventRow).where(EventRow.run_id == run_id).order_by(EventRow.seq)
    rows = session.scalars(mine, execution_options={"yield_per": 100})
    events: list[RunEvent] = []
    length = 0
    for number, row in enumerate(rows, start=1):
        length += len(row.body)
        if length > _LONGEST_EVENTS:
            raise InvalidInput(
                f"the events of {run_id} in the archive have more than {_LONGEST_EVENTS} characters"
            )
        try:
            event = event_from_json(row.body)
        except ValidationError as error:
            raise InvalidInput(
                f"event {number} of {run_id} in the archive: {explain(error, 'event')}"
            ) from error
        if (row.seq, row.key, row.type) != (number, event.key, event.type):
            raise InvalidInput(f"event {number} of {run_id} in the archive has another's columns")
        if isinstance(event, IterationFinished) and not _fits_together(event):
            raise InvalidInput(
                f"event {number} of {run_id} in the archive needs as many distributions, flags and "
                "lists of returns as policies (or no returns), and lists of one length"
            )
        events.append(event)
    return events


def _fits_together(event: IterationFinished) -> bool:
    """True if the lists of an iteration are as a run reports them."""
    count, returns = len(event.policies), event.returns
    trained = (event.source_returns, event.reached_threshold, event.training_steps)
    are_alike = all(len(each) == count for each in (event.distributions, *trained))
    is_evaluated = len(returns) == count and len({len(episodes) for episodes in returns}) == 1
    return count > 0 and are_alike and (is_evaluated or not returns)


def _is_in_order(lifecycle: Sequence[_Lifecycle]) -> bool:
    """True if each event is of the submission that was queued last."""
    submission = 0
    for event in lifecycle:
        if isinstance(event, RunQueued):
            if event.submission <= submission:
                return False
            submission = event.submission
        elif not isinstance(event, RunSucceeded) and event.submission != submission:
            return False
    return True


def _expected(spec: RunSpec, benchmark_id: str, lifecycle: Sequence[RunEvent]) -> dict[str, Any]:
    """The columns of a run's row that follow from its spec and its events."""
    row = new_run(spec, benchmark_id)
    state, last = state_after(lifecycle), lifecycle[-1] if lifecycle else None
    failed = last if isinstance(last, RunFailed) else None
    return {
        **{name: row[name] for name in _DERIVED},
        "state": state,
        "submission": max((e.submission for e in lifecycle if isinstance(e, RunQueued)), default=0),
        "error_code": failed.code if failed else None,
        "error_message": failed.message if failed else None,
    }


def _facts(row: RunRow) -> dict[str, Any]:
    names = (*_DERIVED, "state", "submission", "error_code", "error_message")
    return {name: getattr(row, name) for name in names}


def _refused(constant: str) -> None:
    raise ValueError(f"{constant} is no number of JSON")


def _finite(text: str) -> float:
    if not isfinite(number := float(text)):
        raise ValueError(f"{text} is too large")
    return number


def _object(text: str, digest: str) -> dict[str, Any]:
    """A stage's JSON object."""
    try:
        value = json.loads(text, parse_constant=_refused, parse_float=_finite)
    except (ValueError, RecursionError):
        value = None
    if not isinstance(value, dict):
        raise InvalidInput(f"stage {digest} in the archive has a column that is no JSON object")
    return cast(dict[str, Any], value)
