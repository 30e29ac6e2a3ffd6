"""Checks of tokens and of answers, and the errors of refusals."""

import re

import httpx2
from pydantic import BaseModel, ValidationError

from adr_service.errors import AdrError, InvalidInput

_LEAST_OF_A_PROXY = 502  # our own 503 and 507 have a Retry-After
_LEAST_S = 0.5  # that we wait, whatever a proxy says: it may say 0 for minutes
_SLOW, _SLOW_S = 408, 2.0  # a request that came too slowly, and seconds until it may be sent again


LONGEST_KEY = 200


class Refused(AdrError):
    """The service refused a request; the message says why."""

    code = "refused"

    def __init__(self, status: int, detail: str, retry_after_s: float | None = None):
        super().__init__(detail)
        self.status, self.retry_after_s = status, retry_after_s


class Unreachable(AdrError):
    """No service answers at the address, or its answer was lost."""

    code = "unreachable"

    def __init__(self, message: str, *, may_be_done: bool = False):
        """`may_be_done`: the service may have got the request, and carry it out."""
        super().__init__(message)
        self.may_be_done = may_be_done


class _Field(BaseModel):
    pointer: str
    detail: str
    given: str


class _Problem(BaseModel):
    """A refusal of the service, as far as its message needs it."""

    detail: str
    errors: list[_Field] = []


def check_token(name: str, token: str) -> None:
    """Refuse a secret that no header can carry; the message does not show it."""
    if not re.fullmatch("[!-~]*", token):
        raise InvalidInput(
            f"{name} has characters that no token has: accepted are those of ASCII, without spaces "
            "and ends of lines"
        )


def check_key(key: str) -> None:
    """Refuse an `Idempotency-Key` that no header can carry, or that the service refuses."""
    if not re.fullmatch(f"[!-~]{{1,{LONGEST_KEY}}}", key):
        raise InvalidInput(
            f"a key has 1 to {LONGEST_KEY} characters of ASCII, without spaces; given {key!r}"
        )


def check_answer(response: httpx2.Response, url: str) -> None:
    """Raise Refused or Unreachable for an answer that is an error, or sends elsewhere."""
    if response.is_redirect:  # any 3xx, with or without a place
        place = response.headers.get("location", "nowhere")
        raise Unreachable(
            f"the server at {url} answers {response.status_code} and sends to {place!r}; name the "
            "address of the service itself in ADR_URL"
        )
    if not response.is_error:
        return
    wait = response.headers.get("Retry-After")
    after = max(float(wait), _LEAST_S) if wait is not None and wait.isdigit() else None
    status = response.status_code
    if after is None and status == _SLOW:
        after = _SLOW_S
    if after is None and status >= _LEAST_OF_A_PROXY:
        raise Unreachable(
            f"the server at {url} is not the service: {status} {response.reason_phrase}; if it is "
            "a proxy that waited too long, the service may still do what was asked",
            may_be_done=True,
        )
    raise Refused(status, _explain(response), after)


def _explain(response: httpx2.Response) -> str:
    try:
        problem = _Problem.model_validate_json(response.content)
    except ValidationError:  # another server's
        return f"{response.status_code} {response.text[:200]}"
    if response.status_code == 401:
        return "the service asks for its token: set ADR_TOKEN, or correct it"
    details = [f"{e.pointer}: {e.detail} (given: {e.given})" for e in problem.errors]
    return "\n  ".join([problem.detail, *details])
