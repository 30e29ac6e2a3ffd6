"""Points at which tests kill the service: just before and just after each transaction commits.

ADR_FAILPOINT=NAME ends the process at that point as kill -9 would; ADR_FAILPOINT=list logs the
name of every point that the process passes, so that a test can go through all of them.
"""

import logging
import os

log = logging.getLogger(__name__)
_CHOSEN = os.environ.get("ADR_FAILPOINT")
_KILLED = 137  # the exit status of a process that SIGKILL ended, as shells report it


def failpoint(name: str) -> None:
    """End the process here if ADR_FAILPOINT is `name`."""
    if name == _CHOSEN:
        os._exit(_KILLED)
    if _CHOSEN == "list":
        log.info("failpoint %s", name)
