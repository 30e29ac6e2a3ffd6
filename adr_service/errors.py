"""Errors that this project raises on purpose, and the reasons for which a run can fail.

AdrError
├── InvalidInput          the input cannot be used; the message says which input can
│   └── UnknownName       no member has that name; nearest match and the list
├── InfeasibleDistribution  no draw of the distribution can be simulated
├── BudgetExceeded        a method asked the target for more than the spec allows
├── StageFailed           a stage ended without a result, after its attempts
└── RunCancelled          a user asked the run to stop
"""

import difflib
from collections.abc import Iterable
from enum import StrEnum
from typing import Self

_LONGEST = 100  # characters of a wrong name that a message repeats


class FailureCode(StrEnum):
    """Reasons for which a run fails, as `run.error.code` names them; with a remedy each."""

    meaning: str
    remedy: str

    def __new__(cls, code: str, meaning: str, remedy: str) -> Self:
        member = str.__new__(cls, code)
        member._value_, member.meaning, member.remedy = code, meaning, remedy
        return member

    WORKER_LOST = (
        "worker_lost",
        "The process that computed a stage died, or hung, in each of three attempts.",
        "Look for a lack of memory on the nodes (`dmesg`, Ray's dashboard), then resume the run.",
    )
    TARGET_FAILED = (
        "target_failed",
        "A robot's client reported that no robot can do an episode.",
        "Do what the message asks for at the robot, then resume the run.",
    )
    NOT_STORED = (
        "not_stored",
        "The database refused a stage's result, or to look it up.",
        "Look for the cause in the service's log and with `adr db check`, then resume the run.",
    )
    INVALID_INPUT = (
        "invalid_input",
        "The run's spec, dataset or a robot's recording cannot be used.",
        "Submit a new run with the input that the message accepts. If your own method or task is "
        "wrong: correct it, raise its version, install it, start the service again, and resume the "
        "run, or submit it anew if a stage of the former version has finished.",
    )
    UNKNOWN_NAME = (
        "unknown_name",
        "The run names a task, method or parameter that is not installed.",
        "Install the package that has it where the service and its workers run, then resume "
        "the run.",
    )
    LOST_SPEC = (
        "lost_spec",
        "The run's spec cannot be read: its method or task is not installed, or has other fields.",
        "Install the package in the version of that time where the service and its workers run, "
        "start the service again, and resume the run.",
    )
    INFEASIBLE_DISTRIBUTION = (
        "infeasible_distribution",
        "No draw of an inferred distribution can be simulated.",
        "Submit a new run with more transitions or another seed, or check the recording's units.",
    )
    BUDGET_EXCEEDED = (
        "budget_exceeded",
        "The method asked for more target data than the spec allows.",
        "Submit a new run with a larger budget, or correct the method.",
    )
    NOT_FOUND = (
        "not_found",
        "A dataset that the run learns from is not in the database.",
        "Upload the dataset again, then resume the run.",
    )
    DATABASE_DAMAGED = (
        "database_damaged",
        "The database's file is damaged where the run reads it.",
        "Stop the service and restore a backup with `adr db restore`, then resume the run.",
    )
    INTERNAL = (
        "internal",
        "A defect of the service, or of a user's own task or method.",
        "Read the traceback in the service's log. Report a defect of the service. Correct one of "
        "your own method or task, raise its version, install it, start the service again, and "
        "resume the run, or submit it anew if a stage of the former version has finished.",
    )


def remedy_of(code: str) -> str | None:
    """The remedy for a failed run; None for a code of a user's own error class."""
    return FailureCode(code).remedy if code in FailureCode.__members__.values() else None


class AdrError(Exception):
    """Base of all errors raised on purpose; `code` is for machines, the message for people."""

    code: str = "error"


class InvalidInput(AdrError):
    """The input cannot be used."""

    code = FailureCode.INVALID_INPUT


class UnknownName(InvalidInput, LookupError):
    """A name that its catalogue does not have."""

    code = FailureCode.UNKNOWN_NAME

    def __init__(self, kind: str, given: str, accepted: Iterable[str]):
        names = list(accepted)
        given = given if len(given) <= _LONGEST else f"{given[:_LONGEST]}…"
        close = difflib.get_close_matches(given, names, n=1)
        hint = f" did you mean {close[0]!r}?" if close else ""
        super().__init__(f"there is no {kind} {given!r};{hint} accepted: {', '.join(names)}")


class InfeasibleDistribution(AdrError):
    """A distribution none of whose draws can be simulated."""

    code = FailureCode.INFEASIBLE_DISTRIBUTION


class BudgetExceeded(AdrError):
    """A method asked the target for more data than the spec allows."""

    code = FailureCode.BUDGET_EXCEEDED

    def __init__(self, what: str, used: int, asked: int, allowed: int):
        super().__init__(
            f"{what}: {used} used and {asked} more asked for, but the budget is {allowed}"
        )


class StageFailed(AdrError):
    """A stage ended without a result; `cause` is its code, e.g. `worker_lost`."""

    code = "stage_failed"

    def __init__(self, label: str, cause: str, detail: str):
        super().__init__(f"{label}: {detail}")
        self.cause = cause


def target_failed(kind: str, message: str) -> StageFailed:
    """The failure of a stage of this kind that no robot can do, for the reason it gave."""
    return StageFailed(kind, FailureCode.TARGET_FAILED, message)


class RunCancelled(AdrError):
    """A user asked the run to stop, or the service stops; finished stages are kept."""

    code = "cancelled"
