"""Everything this project raises on purpose.

AdrError
├── InvalidInput          what was given cannot be used; says what can
│   └── UnknownName       no member of that name; nearest match and the list
├── InfeasibleDistribution  no draw of the distribution can be simulated
├── BudgetExceeded        the target was asked for more than the spec allows
├── StageFailed           a stage ended without a result, after its attempts
└── RunCancelled          somebody asked the run to stop
"""

import difflib
from collections.abc import Iterable

_LONGEST = 100  # characters of a wrong name that a message repeats


class AdrError(Exception):
    """Base of all errors raised on purpose; `code` is what machines read."""

    code = "error"


class InvalidInput(AdrError):
    """What was given cannot be used."""

    code = "invalid_input"


class UnknownName(InvalidInput, LookupError):
    """A name that its catalogue does not have."""

    code = "unknown_name"

    def __init__(self, kind: str, given: str, accepted: Iterable[str]):
        names = list(accepted)
        given = given if len(given) <= _LONGEST else f"{given[:_LONGEST]}…"
        close = difflib.get_close_matches(given, names, n=1)
        hint = f" did you mean {close[0]!r}?" if close else ""
        super().__init__(f"there is no {kind} {given!r};{hint} accepted: {', '.join(names)}")


class InfeasibleDistribution(AdrError):
    """A distribution none of whose draws can be simulated."""

    code = "infeasible_distribution"


class BudgetExceeded(AdrError):
    """The target domain was asked for more data than the spec allows."""

    code = "budget_exceeded"

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


class RunCancelled(AdrError):
    """Somebody asked the run to stop; finished stages are kept."""

    code = "cancelled"
