"""Starting or joining a Ray cluster, whose processes have one thread each.

cluster = Cluster(options)
cluster.start()             # or join; ClusterUnavailable with the reason
cluster.is_alive            # False once Ray has died
cluster.restart()           # or join again; ClusterUnavailable while that cannot be
"""

import os
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import psutil
import ray
from joblib import cpu_count

from adr_service.errors import AdrError
from adr_service.training.xla import ONE_THREAD
from workers.gcs import JoinedGcs, OwnGcs, child, lives
from workers.sessions import Sessions


class ClusterUnavailable(AdrError):
    """Ray could not be started or joined."""

    code = "cluster_unavailable"


@dataclass(frozen=True)
class RayOptions:
    """Settings with which to start or join a cluster."""

    address: str = "local"  # "local" starts one; else an address, or "auto"
    cpus: int | None = None  # of a local cluster; None: all that this process may use
    dashboard: bool = True
    compile_cache: Path = Path.home() / ".cache" / "adr_service" / "jax"
    # of a local cluster's token and sessions; None: a temporary one, deleted at exit
    folder: Path | None = None
    keep_idle_s: float = 600.0  # how long a process stays warm for the next stage
    resource: str = "CPU"  # of a node, as Ray counts it: one for each core that computes stages
    max_cores: int | None = None  # at work at once, and asked of an autoscaler; None: all there are

    @property
    def cpus_to_count(self) -> int:
        """`cpus`, or those that this process may use: Ray knows a container's limit, but not a set
        that `taskset` or Slurm keeps a process to."""
        return self.cpus or cpu_count()


class Cluster:
    """Ray, as this process has started or joined it. On one thread."""

    def __init__(self, options: RayOptions):
        self.is_local = options.address == "local"
        self._options = options
        self._sessions = Sessions(options.folder) if self.is_local else None
        self._is_joined = False
        self._raylet: psutil.Process | None = None  # of a local cluster
        is_named = not self.is_local and options.address != "auto"
        self._ours: OwnGcs | None = None
        self._joined = JoinedGcs(options.address) if is_named else None
        self.dashboard_url: str | None = None

    def start(self) -> None:
        """`ray.init` for our processes. Raises ClusterUnavailable with the reason."""
        options = self._options
        arguments: dict[str, Any] = {"log_to_driver": False, "configure_logging": False}
        if self._sessions is not None:
            # the mode stays unset: Ray turns it on for a local cluster, and notices
            os.environ["RAY_AUTH_TOKEN_PATH"] = str(self._sessions.token)
            arguments["num_cpus"] = options.cpus_to_count
            arguments["include_dashboard"] = options.dashboard
            arguments["object_store_memory"] = 200_000_000
            arguments["_temp_dir"] = str(self._sessions.path)
            self._ours = OwnGcs(self._sessions.path)
            self._ours.start()
            # prestarted processes would be without our environment, so never used
            no_prestart = {"prestart_worker_first_driver": False}
            arguments["_system_config"] = {**no_prestart, **self._ours.config}
        elif self._joined is not None and not self._joined.is_alive:
            raise ClusterUnavailable(f"no Ray cluster answers at {self._joined.address}")
        # by default, actors import from the folder in which the service was started, first of all
        with TemporaryDirectory() as empty:
            environment = {
                "env_vars": worker_environment(options.compile_cache),
                "working_dir": empty,
            }
            try:
                context: Any = ray.init(
                    address=options.address, namespace="adr", runtime_env=environment, **arguments
                )
            except Exception as error:  # whatever Ray raises
                raise ClusterUnavailable(f"Ray did not start: {error}") from error
        self.dashboard_url = f"http://{url}" if (url := context.dashboard_url) else None
        if self.is_local:
            self._raylet = child("raylet")
            if self._raylet is None:
                raise ClusterUnavailable("Ray did not start: there is no raylet")
        elif self._joined is None:
            self._joined = JoinedGcs(context.address_info["gcs_address"])
        self._is_joined = True

    @property
    def remedy(self) -> str:
        """The next step after Ray has died, for the log."""
        if self.is_local:
            return "starting it again"
        address = self._options.address if self._joined is None else self._joined.address
        return (
            f"waiting until its head answers again at {address}, and a node of the "
            "cluster is on this machine (ray start --address=HEAD:6379 --num-cpus=0)"
        )

    @property
    def is_alive(self) -> bool:
        """True while Ray can be asked: we have joined, its GCS lives, and our own raylet if any.

        It does not ask Ray itself, whose calls to a dead GCS block.
        """
        if not self._is_joined or (self._raylet is not None and not lives(self._raylet)):
            return False
        gcs = self._ours or self._joined
        return gcs is not None and gcs.is_alive

    def restart(self) -> None:
        """Start a local cluster again after its death, or join again."""
        self.stop()
        if self._sessions is not None:
            self._sessions.clear()
        self.start()

    def stop(self) -> None:
        """`ray.shutdown`."""
        self._is_joined, self._raylet = False, None
        ours, self._ours = self._ours, None
        if ours is not None:
            ours.leave_alone()
        ray.shutdown(wait_for_processes=True)  # or the next start would find the old ones
        if ours is not None:
            ours.end()

    def close(self) -> None:
        """`stop`, and let another service have the folder."""
        self.stop()
        if self._joined is not None:
            self._joined.close()
        if self._sessions is not None:
            self._sessions.close()


def worker_environment(compile_cache: Path) -> dict[str, str]:
    """One thread per process, and compiled programs kept between processes."""
    single = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
    return {
        **dict.fromkeys(single, "1"),
        **ONE_THREAD,
        "JAX_PLATFORMS": "cpu",
        "JAX_COMPILATION_CACHE_DIR": str(compile_cache),
        "JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS": "0",
        "JAX_PERSISTENT_CACHE_MIN_ENTRY_SIZE_BYTES": "-1",
    }
