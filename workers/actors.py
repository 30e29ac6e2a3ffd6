"""Ray's processes: they compute stages and report signs of life.

Nothing here opens a database or draws an unnamed random number. An ending is a value
(`Finished`, `Failed`, `Stopped`), so that an exception from Ray always means a lost process.
"""

import os
import threading
import time
import traceback
from dataclasses import dataclass, replace
from typing import Any

import ray
from ray.exceptions import RayError

from adr_service.benchmark.cost import Execution
from adr_service.errors import AdrError, FailureCode
from adr_service.progress import Checkpoint, StageCancelled
from adr_service.provenance import provenance
from adr_service.stages.base import AnyStage, StageResult, compute
from adr_service.startup_time import preparation_seconds
from workers.heartbeats import SignOfLife

SIGN_OF_LIFE_S = 1.0


@dataclass(frozen=True)
class Finished:
    """The stage has a result."""

    result: StageResult
    execution: Execution  # with what the process measured


@dataclass(frozen=True)
class Failed:
    """The stage itself went wrong; trying again would end the same."""

    code: str
    message: str


@dataclass(frozen=True)
class Stopped:
    """No run wanted the result any more."""


Ending = Finished | Failed | Stopped


class StageActor:
    """A process that computes stages, one after the other."""

    def compute(self, stage: AnyStage, placed: Execution, board: Any) -> Ending:
        """Compute a stage, reporting at least every `SIGN_OF_LIFE_S`.

        `placed` is its execution as far as the dispatcher knows it.
        """
        reporter, clock = _Reporter(stage.digest, placed.attempt, board), _Clock()
        try:
            with reporter:
                result = compute(stage, reporter.progress)
        except StageCancelled:
            return Stopped()
        except AdrError as error:
            return Failed(error.code, str(error))
        # a defect must reach the run as its failure; a method may even exit
        except (Exception, SystemExit) as error:  # noqa: BLE001
            trace = "".join(traceback.format_exception(error)[-4:])
            return Failed(FailureCode.INTERNAL, f"{type(error).__name__}: {error}\n{trace}")
        return Finished(result, replace(clock.measured(placed), provenance=provenance()))


class _Clock:
    """Measures one stage, from the moment at which it is made."""

    _stages = 0  # that this process has begun

    def __init__(self) -> None:
        self._is_first = _Clock._stages == 0
        _Clock._stages += 1
        self._began, self._preparing = time.time(), preparation_seconds()
        self._steady, self._cpu = time.monotonic(), time.process_time()

    def measured(self, placed: Execution) -> Execution:
        """The execution with what this process has measured until now.

        By a steady clock: the other one may be set while a stage computes.
        """
        return replace(
            placed,
            began=self._began,
            ended=self._began + time.monotonic() - self._steady,
            cpu=time.process_time() - self._cpu,
            preparing=preparation_seconds() - self._preparing,
            is_first=self._is_first,
        )


class _Reporter:
    """Sends the latest progress from a thread, so that compiling code shows life as well."""

    def __init__(self, digest: str, attempt: int, board: Any):
        self._computed, self._board = (digest, attempt), board
        self._latest: tuple[float, dict[str, Any]] = (0.0, {})
        self._checkpoint: Checkpoint | None = None
        self._unwanted, self._done = threading.Event(), threading.Event()
        self._thread = threading.Thread(target=self._report, daemon=True)

    def __enter__(self) -> "_Reporter":
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._done.set()
        self._thread.join()

    def progress(self, fraction: float, checkpoint: Checkpoint | None = None, **facts: Any) -> None:
        if self._unwanted.is_set():
            raise StageCancelled
        self._latest = (fraction, facts)
        if checkpoint is not None:
            self._checkpoint = checkpoint

    def _report(self) -> None:
        reported: Checkpoint | None = None
        actor_id = str(ray.get_runtime_context().get_actor_id())
        while not self._done.is_set():
            checkpoint = self._checkpoint
            news = None if checkpoint is reported else checkpoint
            sign = SignOfLife(*self._computed, *self._latest, actor_id, os.getpid(), news)
            try:
                if ray.get(self._board.report.remote(sign)):
                    self._unwanted.set()
                reported = checkpoint
            except RayError:
                pass  # the board is starting again; the next sign reaches it
            self._done.wait(SIGN_OF_LIFE_S)
