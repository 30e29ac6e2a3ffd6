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


class DatabaseNewer(AdrError):
    """A later version of the service has written the database."""

    code = "database_newer"


class DatabaseUnavailable(AdrError):
    """The database cannot be used just now; what was asked for may be asked for again."""

    code = "database_unavailable"


class DatabaseGone(DatabaseUnavailable):
    """The database's files are not there any more."""

    code = "database_gone"


class DatabaseDamaged(AdrError):
    """The database's file has something wrong; a backup helps."""

    code = "database_damaged"


class DatabaseInUse(DatabaseUnavailable):
    """Another service holds the database."""

    code = "database_in_use"


class DiskFull(DatabaseUnavailable):
    """Nothing can be stored before somebody frees the disk."""

    code = "disk_full"
