"""Check that the requests of robots, and the answers, fit exclusive leases.

Each request is written down when it begins, and again once it is answered. One whose answer
nobody heard, as its robot or the service was killed, may have been carried out or not.
"""

import itertools
import json
import math
import time
from collections import Counter, defaultdict
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any
from uuid import uuid4

import httpx2

from adr_service.client import AdrClient, Json, Refused

_TASKS = "/v1/target_tasks/"
_RENEWALS = {"claim", "heartbeat"}
_ENDS = {"release", "fail"}
_WAIT_S = 0.5


@dataclass(frozen=True)
class Request:
    """A request; times are seconds of the machine's monotonic clock.

    A claim has the visit and the lease that it was given, and `attempt`, its number among the
    visit's claims as the service counts them; all three are empty if it was given none.
    """

    kind: str  # claim, heartbeat, trajectory, release or fail
    visit: str
    lease: str
    began: float
    answered: float = math.inf
    status: int | None = None  # None: no answer was heard
    attempt: int = 0

    @property
    def is_accepted(self) -> bool:
        return self.status == 200

    @property
    def is_unknown(self) -> bool:
        """True if it may have been carried out: no answer, or that of a database that failed."""
        return self.status is None or self.status >= 500


class RecordedClient(AdrClient):
    """A client that writes its requests for tasks into a file, and the answers.

    All requests of a client go through `_request`, so that none is missed.
    """

    def __init__(self, url: str, timeout_s: float, file: IO[str]):
        super().__init__(url, "", timeout_s)
        self._file = file

    def claim_task(self, worker: str, tasks: Sequence[str], wait_s: float = 20.0) -> Json | None:
        """Wait briefly, so that the beginning of a lease is known to `_WAIT_S`."""
        return super().claim_task(worker, tasks, min(wait_s, _WAIT_S))

    def _request(self, method: str, path: str, **more: Any) -> httpx2.Response:
        if method == "GET" or not path.startswith(_TASKS):
            return super()._request(method, path, **more)
        id = uuid4().hex
        lease = more.get("headers", {}).get("Lease") or more.get("json", {}).get("lease", "")
        *visit, kind = path.removeprefix(_TASKS).split("/")
        self._write(id, kind=kind, visit="".join(visit), lease=lease, began=time.monotonic())
        try:
            response = super()._request(method, path, **more)
        except Refused as error:
            self._write(id, answered=time.monotonic(), status=error.status)
            raise
        answer: dict[str, Any] = {"answered": time.monotonic(), "status": response.status_code}
        if kind == "claim" and response.content:
            given = response.json()
            task = given["task"]
            answer |= {"visit": task["id"], "attempt": task["attempt"], "lease": given["lease"]}
        self._write(id, **answer)
        return response

    def _write(self, id: str, **facts: Any) -> None:
        # one write, so that lines of several threads and processes do not mix
        self._file.write(json.dumps({"id": id, **facts}) + "\n")
        self._file.flush()


def read_history(files: Iterable[Path]) -> list[Request]:
    """All requests of several robots, in the order in which they began."""
    facts: dict[str, dict[str, Any]] = defaultdict(dict)
    for file in files:
        for line in file.read_text().splitlines():
            part = json.loads(line)
            facts[part.pop("id")] |= part
    return sorted((Request(**whole) for whole in facts.values()), key=lambda request: request.began)


def violations(history: Sequence[Request], lease_s: float) -> list[str]:
    """Contradictions between a history and exclusive leases of `lease_s`."""
    claims = [request for request in history if request.kind == "claim" and request.lease]
    given = Counter(claim.lease for claim in claims)
    found = [f"lease {lease} was given {n} times" for lease, n in given.items() if n > 1]
    under: dict[str, list[Request]] = defaultdict(list)
    for request in history:
        under[request.lease].append(request)
    of_visits: dict[str, list[Request]] = defaultdict(list)
    for claim in sorted(claims, key=lambda claim: claim.attempt):
        of_visits[claim.visit].append(claim)
    for visit, its_claims in of_visits.items():
        for earlier, later in itertools.combinations(its_claims, 2):
            about = f"{visit}, claims {earlier.attempt} and {later.attempt}"
            wrong = _wrong_of_two(earlier, later, under[earlier.lease], lease_s)
            found += [f"{about}: {what}" for what in wrong]
    return found


def _wrong_of_two(
    earlier: Request, later: Request, under: Sequence[Request], lease_s: float
) -> Iterator[str]:
    """Contradictions between two claims of a visit, and the requests under the earlier one."""
    if earlier.attempt == later.attempt:
        yield "two claims have one number"
    if later.answered < earlier.began:
        yield "their numbers are not in order"
    accepted = [request for request in under if request.is_accepted]
    for request in accepted:
        if request.kind == "trajectory":
            yield "the trajectory of the earlier one was accepted"
        elif request.began > later.answered:
            yield f"a {request.kind} of the earlier one was accepted after the later one"
    may_have_ended = (
        request.kind in _ENDS and (request.is_accepted or request.is_unknown)
        for request in under
        if request.began < later.answered
    )
    if any(may_have_ended):
        return
    until = lease_s + max(request.began for request in accepted if request.kind in _RENEWALS)
    if later.answered < until:
        yield f"they overlap by {until - later.answered:.3g} s"
