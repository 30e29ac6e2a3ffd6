"""What the database refuses."""

from adr_service.errors import AdrError


class NotFound(AdrError):
    """There is no such thing in the database."""

    code = "not_found"

    def __init__(self, kind: str, given: str):
        super().__init__(f"there is no {kind} {given!r}")


class NotPossible(AdrError):
    """The thing exists, but its state does not allow this."""

    code = "conflict"
