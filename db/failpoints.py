"""Where tests let the service die: at every transaction, just before and just after it is on disk.

ADR_FAILPOINT=NAME ends the process there as kill -9 would; ADR_FAILPOINT=list logs every name that
is passed, so that a test can go through all of them.
"""

import logging
import os

log = logging.getLogger(__name__)
_CHOSEN = os.environ.get("ADR_FAILPOINT")
_KILLED = 137  # the exit status of a process that SIGKILL ended, as shells tell it


def failpoint(name: str) -> None:
    if name == _CHOSEN:
        os._exit(_KILLED)
    if _CHOSEN == "list":
        log.info("failpoint %s", name)
