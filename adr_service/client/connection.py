"""A connection to a running service, request by request."""

import json
import os
import re
import time
from collections.abc import Generator, Iterator, Sequence
from contextlib import contextmanager
from functools import partial
from typing import IO, Any, Self
from uuid import uuid4

import httpx2

from adr_service.client.http import (
    Unreachable,
    check_answer,
    check_key,
    check_token,
)
from adr_service.client.patience import may_be_done, patiently
from adr_service.client.progress import headline, runs_of, succeeded
from adr_service.client.tables import Json, Results, Rows
from adr_service.errors import InvalidInput

DEFAULT_URL = "http://127.0.0.1:8000"
_AFTER_SENDING = (httpx2.ReadError, httpx2.RemoteProtocolError)
_POLL_S = 1.0
_PATIENCE_S = 300.0  # for a service that is busy or restarts, while something is watched
_SUBMITTING_S = 30.0  # the same, while something is submitted
_LONG_S = 3600.0  # for an archive to be written or read


class AdrClient:
    """A connection to the service at `url`; a context manager, which closes it.

    `token` is the service's ADR_TOKEN, if it has one. A request ends where nothing of it can be
    sent or comes back for `timeout_s` seconds, one that writes or reads an archive for an hour.
    """

    def __init__(self, url: str = DEFAULT_URL, token: str = "", timeout_s: float = 60.0):
        headers = {"Authorization": f"Bearer {token}"} if token else {}
        self.url = url.rstrip("/")
        shown = re.sub(r"^(\w+://)?[^/]*@", r"\1", url)  # without a proxy's name and password
        check_token("ADR_TOKEN", token)
        if token and shown != url:
            raise InvalidInput(
                "a request has one password: give the service's token (ADR_TOKEN), or a name and "
                f"password in the address, as for a proxy, and not both; given both for {shown!r}"
            )
        if not self.url.lower().startswith(("http://", "https://")):
            raise InvalidInput(
                f"an address begins with http:// or https://, as {DEFAULT_URL}; given {shown!r}"
            )
        try:
            self._http = httpx2.Client(base_url=self.url, headers=headers, timeout=timeout_s)
        except httpx2.InvalidURL as error:
            raise InvalidInput(f"{shown!r} is no address of a service: {error}") from error
        self.url = shown.rstrip("/")

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._http.close()

    def submit_run(self, spec: Json, *, dry_run: bool = False, key: str | None = None) -> Json:
        """Submit a run; `dry_run` starts nothing, and its answer has the expected cost, `plan`.

        Requests with the same `key` within a day start one run. Each call has one of its own by
        default, and repeats the request for half a minute while the service is busy, or after an
        answer was lost.
        """
        return self._submit("/v1/runs", spec, key, dry_run)

    def submit_benchmark(
        self, spec: Json, *, dry_run: bool = False, key: str | None = None
    ) -> Json:
        """Submit a benchmark; `dry_run` and `key` as in `submit_run`."""
        return self._submit("/v1/benchmarks", spec, key, dry_run)

    def submit_criticism(self, spec: Json, *, key: str | None = None) -> Json:
        """Criticise a task's simulator with an uploaded measurement; `key` as in `submit_run`."""
        return self._submit("/v1/criticisms", spec, key)

    def criticism(self, run_id: str) -> Json:
        """State of a criticism, and its verdict once there is one."""
        return self._json("GET", _criticism(run_id))

    def criticism_file(self, run_id: str, name: str) -> bytes:
        """`report.html`, `verdict.json`, `extended.xml` or `effects.json`."""
        return self.content(f"{_criticism(run_id)}/{name}")

    def extend_benchmark(
        self, benchmark_id: str, extension: Json, *, dry_run: bool = False, key: str | None = None
    ) -> Json:
        """Add seeds, methods, … to a benchmark; `dry_run` and `key` as in `submit_run`."""
        return self._submit(f"{_path(benchmark_id)}/extend", extension, key, dry_run)

    def upload(self, content: bytes, task: str | None = None, name: str | None = None) -> Json:
        """Store a recording; with `task`, also check that it is of that task.

        The file's `name` is the origin of data that say none.
        """
        given = {"task": task, "name": name}
        return self._json(
            "POST",
            "/v1/datasets",
            content=content,
            headers={"Content-Type": "application/octet-stream"},
            params={key: value for key, value in given.items() if value is not None},
        )

    def recording(self, dataset_id: str) -> bytes:
        """An uploaded recording as `.npz`, for `TransitionDataset.from_npz`."""
        return self.content(f"{_path(dataset_id)}/content")

    def get(self, id: str) -> Json:
        """A run, a benchmark or a recording, by its id."""
        return self._json("GET", _path(id))

    def list_all(self, collection: str, **filters: str) -> Rows:
        """All "runs", "benchmarks", "datasets" or "target_tasks", page after page.

        Runs can be filtered by `task`, `method`, `state` and `benchmark_id`, the tasks of robots by
        `state` and `run_id`.
        """
        return self._pages(f"/v1/{collection}", "page_token", **filters)

    def export_archive(self, benchmark_id: str, file: IO[bytes], part: Json | None = None) -> None:
        """Write a benchmark with all its results to a file.

        `part` keeps only some members, as in `{"methods": ["bayrn"], "seeds": [0, 1]}`.
        """
        path = f"{_path(benchmark_id)}/archive"
        sent = self._http.stream("GET", path, params=part, timeout=_LONG_S)
        with self._answering(), sent as response:
            if response.is_error:
                response.read()
            check_answer(response, self.url)
            for portion in response.iter_bytes():
                file.write(portion)

    def import_archive(self, file: IO[bytes]) -> Json:
        """Add what the service lacks of a benchmark's archive."""
        headers = {"Content-Type": "application/octet-stream"}
        return self._json("POST", "/v1/archives", content=file, headers=headers, timeout=_LONG_S)

    def cost(self, id: str) -> Json:
        """Cost of a run or a benchmark so far."""
        return self._json("GET", f"{_path(id)}/cost")

    def get_events(self, run_id: str) -> Rows:
        """All events of a run so far."""
        return self._pages(f"{_path(run_id)}/events", "after")

    def cancel(self, id: str) -> Json:
        """Ask a run, or all live runs of a benchmark, to stop; finished stages are kept."""
        return self._json("POST", f"{_path(id)}/cancel")

    def resume(self, id: str) -> Json:
        """Continue a failed or cancelled run, or all of a benchmark."""
        return self._json("POST", f"{_path(id)}/resume")

    def delete(self, id: str) -> None:
        """Delete a dataset, or a finished run or benchmark and what only that refers to."""
        self._request("DELETE", _path(id))

    def results(self, id: str) -> Results:
        """Tables of a run's or a benchmark's results, as far as there are any yet."""
        return Results(self._json("GET", f"{_path(id)}/results"))

    def results_csv(self, id: str) -> str:
        """The table of returns as CSV."""
        return self.content(f"{_path(id)}/results?format=csv").decode()

    def citations(self, id: str) -> str:
        """The papers of what a run or a benchmark has run, as BibTeX."""
        return self.content(f"{_path(id)}/citations").decode()

    def figure(self, id: str, name: str) -> bytes:
        """A figure by file name, "returns.svg", "parameters.png", "cost.csv"."""
        return self.content(f"{_path(id)}/figures/{name}")

    def figures(self, id: str) -> list[str]:
        """Names of the figures that can be drawn by now."""
        return list(self._json("GET", f"{_path(id)}/figures"))

    def trainings(self, run_id: str) -> Rows:
        """A run's trainings with their learning curves, also those that go on."""
        return Rows(self._json("GET", f"{_path(run_id)}/trainings"))

    def curves(self, run_id: str) -> Rows:
        """The learning curves of a run, a row for each evaluation of each training.

        `training` counts from 0, in the order of first evaluations, and `digest` names it; `steps`
        are of its environments, `mean_return` and its `standard_error` are over episodes in
        simulation, `time` is when the point was stored.
        """
        return Rows(
            {"training": number, "digest": training["digest"], **point}
            for number, training in enumerate(self.trainings(run_id))
            for point in training["curve"]
        )

    def policy_of_training(self, run_id: str, digest: str) -> bytes:
        """Policy of one of a run's trainings; while it goes on, the best so far."""
        return self.content(f"{_path(run_id)}/trainings/{digest}/policy")

    def claims(self, benchmark_id: str | None = None) -> list[Json]:
        """The paper's claims, compared with a benchmark or with all runs."""
        if benchmark_id is None:
            return list(self._json("GET", "/v1/claims"))
        check_benchmark(benchmark_id, "claims are")
        return list(self._json("GET", f"{_path(benchmark_id)}/claims"))

    def distribution(self, run_id: str) -> Json:
        """Training distribution of the run's latest policy."""
        return self._json("GET", f"{_path(run_id)}/distribution")

    def policy(self, run_id: str) -> bytes:
        """The run's latest policy as safetensors, for `Policy.from_bytes`."""
        return self.content(f"{_path(run_id)}/policy")

    def claim_task(self, worker: str, tasks: Sequence[str], wait_s: float = 20.0) -> Json | None:
        """An episode for a robot, and its lease; None if there is none within `wait_s`."""
        if isinstance(tasks, str):  # a sequence of letters
            raise InvalidInput(f"tasks is a list, as [{tasks!r}]; given {tasks!r}")
        given = {"worker": worker, "tasks": list(tasks), "wait_s": wait_s}
        response = self._request("POST", "/v1/target_tasks/claim", json=given)
        return None if response.status_code == 204 else self._parsed(response)

    def heartbeat(self, task_id: str, lease: str, steps: int) -> Json:
        """Renew the lease of an episode; the answer has `cancel_requested`."""
        given = {"lease": lease, "steps": steps}
        return self._json("POST", f"/v1/target_tasks/{task_id}/heartbeat", json=given)

    def complete_task(self, task_id: str, lease: str, trajectory: bytes) -> Json:
        """Upload the trajectory, an `.npz`."""
        return self._json(
            "PUT",
            f"/v1/target_tasks/{task_id}/trajectory",
            content=trajectory,
            headers={"Content-Type": "application/octet-stream", "Lease": lease},
        )

    def release_task(self, task_id: str, lease: str) -> Json:
        """Give an episode back, for other robots."""
        return self._json("POST", f"/v1/target_tasks/{task_id}/release", json={"lease": lease})

    def fail_task(self, task_id: str, lease: str, message: str) -> Json:
        """Report that no robot can do the task; its run fails."""
        given = {"lease": lease, "message": message}
        return self._json("POST", f"/v1/target_tasks/{task_id}/fail", json=given)

    def tasks(self) -> list[Json]:
        """All tasks, with columns, bounds and control periods."""
        return list(self._json("GET", "/v1/tasks"))

    def methods(self) -> Json:
        """JSON Schema of the methods, with their settings."""
        return self._json("GET", "/v1/methods")

    def presets(self) -> Json:
        """The presets, and the fields of specs that each sets."""
        return self._json("GET", "/v1/presets")

    def ready(self) -> Json:
        """State of the service's database, cores and disk; refused while it cannot compute."""
        return self._json("GET", "/readyz")

    def watch(self, id: str) -> Iterator[Json]:
        """Yield a run or a benchmark every second until it has finished.

        Waits up to five minutes for a service that is busy or restarts, once it has answered.
        """
        seen = self.get(id)
        while True:
            yield seen
            if is_finished(seen):
                return
            time.sleep(_POLL_S)
            seen = patiently(partial(self.get, id), _PATIENCE_S, _POLL_S)

    def wait(self, id: str, *, progress: bool = True) -> Json:
        """Wait until a run or a benchmark has finished, and return its last state.

        `progress` shows a bar, in a notebook (with ipywidgets) or on a terminal. Runs that failed
        do not raise: the answer's `state`, or each of its `runs`, says so.
        """
        from tqdm.auto import tqdm  # asks whether this is a notebook

        seen: Json = {}
        with tqdm(bar_format="{l_bar}{bar}{postfix}", disable=not progress) as bar:
            for seen in self.watch(id):
                runs = runs_of(seen)
                if bar.total != len(runs):
                    bar.reset(total=len(runs))  # a notebook's widget takes its width from it
                bar.n = succeeded(runs)
                bar.set_postfix_str(headline(seen))
        return seen

    def content(self, path: str) -> bytes:
        """The answer to a GET request, as it is."""
        return self._request("GET", path).content

    def _submit(self, path: str, spec: Json, key: str | None, dry_run: bool = False) -> Json:
        """Send a spec; again under the same key where it may have been stored without an answer."""
        ask = partial(self._json, "POST", path, json=_plain(spec), params=_dry(dry_run))
        if dry_run:
            return ask()
        name = str(uuid4()) if key is None else key
        check_key(name)
        ask = partial(ask, headers={"Idempotency-Key": name})
        return patiently(ask, _SUBMITTING_S, _POLL_S, begins=may_be_done)

    def _pages(self, path: str, token_name: str, **params: str) -> Rows:
        items = Rows()
        while True:
            page = self._json("GET", path, params=params)
            items += page["items"]
            if page["next_page_token"] is None:
                return items
            params[token_name] = page["next_page_token"]

    def _json(self, method: str, path: str, **more: Any) -> Any:
        return self._parsed(self._request(method, path, **more))

    def _parsed(self, answer: httpx2.Response) -> Any:
        try:
            return answer.json()
        except ValueError as error:
            asked = f"{answer.request.method} {answer.request.url.path}"
            raise Unreachable(
                f"what answers at {self.url} is not the service: {asked} gave no JSON"
            ) from error

    def _request(self, method: str, path: str, **more: Any) -> httpx2.Response:
        with self._answering():
            response = self._http.request(method, path, **more)
        check_answer(response, self.url)
        return response

    @contextmanager
    def _answering(self) -> Generator[None]:
        """Raise Unreachable if the service does not answer, InvalidInput if it cannot be asked."""
        try:
            yield
        except (httpx2.InvalidURL, UnicodeEncodeError) as error:
            raise InvalidInput(f"an id or a name does not fit into an address: {error}") from error
        except httpx2.TimeoutException as error:
            raise Unreachable(
                f"the service at {self.url} did not answer in time ({type(error).__name__}); "
                "it may still carry out the request",
                may_be_done=isinstance(error, httpx2.ReadTimeout),
            ) from error
        except httpx2.RequestError as error:  # also an answer that cannot be unpacked
            raise Unreachable(
                f"no service answers at {self.url} ({error}); start one with `adr serve`, "
                "or name another with ADR_URL, or its port here with ADR_PORT",
                may_be_done=isinstance(error, _AFTER_SENDING),
            ) from error


def connect(url: str | None = None, timeout_s: float = 60.0) -> AdrClient:
    """Return a client of `url` with the token ADR_TOKEN.

    Without an address it is ADR_URL, or else this machine's port ADR_PORT, or 8000, as `adr serve`
    listens there.
    """
    found = url or os.environ.get("ADR_URL") or _here(os.environ.get("ADR_PORT"))
    return AdrClient(found, os.environ.get("ADR_TOKEN", ""), timeout_s)


def _here(port: str | None) -> str:
    if not port:
        return DEFAULT_URL
    if not port.isdecimal():
        raise InvalidInput(f"ADR_PORT must be the number of a port; given {port!r}")
    return f"{DEFAULT_URL.rpartition(':')[0]}:{port}"


def is_finished(seen: Json) -> bool:
    """True if a run, or every run of a benchmark, has ended."""
    if "is_finished" in seen:
        return bool(seen["is_finished"])
    return seen["state"] in {"succeeded", "failed", "cancelled"}


def check_benchmark(id: str, what: str) -> None:
    """Raise InvalidInput for an id of something else; `what` as "a report is"."""
    if not id.startswith("bench_"):
        raise InvalidInput(f"{what} of a benchmark; given {id}")


def _path(id: str) -> str:
    if not id:
        raise InvalidInput("give the id of a run, a benchmark or a recording; given ''")
    collections = {"bench": "benchmarks", "data": "datasets"}
    return f"/v1/{collections.get(id.partition('_')[0], 'runs')}/{id}"


def _criticism(id: str) -> str:
    if not id:
        raise InvalidInput("give the id of a criticism; given ''")
    return f"/v1/criticisms/{id}"


def _plain(spec: Json) -> Json:
    """The spec with numbers and lists in the place of NumPy's values and of ranges.

    Raises InvalidInput for other values that JSON does not have.
    """
    try:
        return json.loads(json.dumps(spec, default=_number_or_list, allow_nan=False))
    except (TypeError, ValueError) as error:
        raise InvalidInput(f"the spec cannot be sent as JSON: {error}") from error


def _number_or_list(value: Any) -> Any:
    if isinstance(value, range):
        return list(value)
    if hasattr(value, "tolist"):  # of NumPy, which takes a moment to import
        return value.tolist()
    raise TypeError(f"{value!r} is no number, text, list or object")


def _dry(dry_run: bool) -> dict[str, str]:
    return {"validate_only": "true"} if dry_run else {}
