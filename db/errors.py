"""Errors of the database, each with its code."""

from adr_service.errors import AdrError, FailureCode


class NotFound(AdrError):
    """The database has no such run, benchmark, dataset or target task."""

    code = FailureCode.NOT_FOUND

    def __init__(self, kind: str, given: str):
        super().__init__(f"there is no {kind} {given!r}")


class NotPossible(AdrError):
    """The run, benchmark or dataset exists, but its state does not allow the request."""

    code = "conflict"


class DatabaseNewer(AdrError):
    """A later version of the service has written the database."""

    code = "database_newer"


class DatabaseUnavailable(AdrError):
    """The database cannot be used just now; the same request may succeed later."""

    code = "database_unavailable"


class DatabaseGone(DatabaseUnavailable):
    """The database's files were deleted or replaced."""

    code = "database_gone"


class DatabaseDamaged(AdrError):
    """The database's file is damaged; a backup must be restored."""

    code = FailureCode.DATABASE_DAMAGED


class DatabaseInUse(DatabaseUnavailable):
    """Another service holds the database."""

    code = "database_in_use"


class DiskFull(DatabaseUnavailable):
    """The disk is full; nothing can be stored until a user frees some space."""

    code = "disk_full"
