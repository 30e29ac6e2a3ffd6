"""The cores that stages need, reported to the autoscaler of a cluster that was joined.

    demand = Demand(options)
    demand.report(len(waiting) + len(running))      # at every look at the nodes

Ray keeps one request for a cluster, until somebody makes another: it is how many cores there should
be, those in use included. So it falls back to what runs once nothing waits, and the autoscaler
removes nodes that have been idle for as long as it was configured to wait.
"""

import logging
import time

from ray.autoscaler.sdk import request_resources
from ray.exceptions import RayError

from workers.cluster import RayOptions

log = logging.getLogger(__name__)
_REPEAT_S = 10.0  # in case another program has replaced the request


class Demand:
    """The request for cores as last made. On the dispatcher's thread."""

    def __init__(self, options: RayOptions):
        self._core = {"CPU": 1, options.resource: 1}
        self._most = options.max_cores
        self._requested: int | None = None
        self._requested_at = 0.0

    def report(self, cores: int) -> None:
        """Request so many cores, `max_cores` at most; nothing where that is not set."""
        if self._most is None:
            return
        request, now = min(cores, self._most), time.monotonic()
        if request == self._requested and now - self._requested_at < _REPEAT_S:
            return
        try:
            request_resources(bundles=[self._core] * request)
        except RayError as error:  # the next look at the nodes repeats it
            log.warning("the autoscaler was not asked for %d cores: %s", request, error)
            return
        if request != self._requested:
            log.info("asked the autoscaler for %d cores, of %d wanted", request, cores)
        self._requested, self._requested_at = request, now
