"""Starting or joining a Ray cluster, whose processes have one thread each."""

import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import ray

from adr_service.errors import AdrError


class ClusterUnavailable(AdrError):
    """Ray could not be started or joined."""

    code = "cluster_unavailable"


@dataclass(frozen=True)
class RayOptions:
    """How to start or join a cluster."""

    address: str = "local"  # "local" starts one; else an address, or "auto"
    cpus: int | None = None  # of a local cluster; None: all
    dashboard: bool = True
    compile_cache: Path = Path.home() / ".cache" / "adr_service" / "jax"
    token_file: Path | None = None  # of a local cluster; None: Ray's own
    keep_idle_s: float = 600.0  # how long a process stays warm for the next stage


def join(options: RayOptions) -> Any:
    """`ray.init` for our processes; what it returns. Raises ClusterUnavailable with the reason."""
    if options.token_file is not None:
        # the mode stays unset: Ray turns it on for a local cluster, and notices
        os.environ["RAY_AUTH_TOKEN_PATH"] = str(options.token_file)
    arguments: dict[str, Any] = {"log_to_driver": False, "configure_logging": False}
    if options.address == "local":
        arguments["num_cpus"] = options.cpus
        arguments["include_dashboard"] = options.dashboard
        arguments["object_store_memory"] = 200_000_000
        # they would be without our environment, so never used
        arguments["_system_config"] = {"prestart_worker_first_driver": False}
    environment = {"env_vars": worker_environment(options.compile_cache)}
    try:
        return ray.init(
            address=options.address, namespace="adr", runtime_env=environment, **arguments
        )
    except Exception as error:  # whatever Ray raises
        raise ClusterUnavailable(f"Ray did not start: {error}") from error


def worker_environment(compile_cache: Path) -> dict[str, str]:
    """One thread per process, and compiled programs kept between processes."""
    # NPROC is XLA's: it has no flag for the number of threads that run a program
    single = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NPROC")
    return {
        **dict.fromkeys(single, "1"),
        "XLA_FLAGS": "--xla_cpu_multi_thread_eigen=false intra_op_parallelism_threads=1",
        "JAX_PLATFORMS": "cpu",
        "JAX_COMPILATION_CACHE_DIR": str(compile_cache),
        "JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS": "0",
        "JAX_PERSISTENT_CACHE_MIN_ENTRY_SIZE_BYTES": "-1",
    }
