"""JAX on one thread: the last digits of its results depend on how many there are.

on_one_thread()                     # before anything computes by JAX in this process
env = {**os.environ, **ONE_THREAD}  # of a process that will
"""

import logging
import os
from functools import cache

log = logging.getLogger(__name__)
ONE_THREAD = {
    "NPROC": "1",  # XLA has no flag for the number of threads that run a program
    "XLA_FLAGS": "--xla_cpu_multi_thread_eigen=false intra_op_parallelism_threads=1",
}


@cache
def on_one_thread() -> None:
    """Let JAX compute on one thread from now on; it chooses once per process, when it begins."""
    import jax
    from jax._src.xla_bridge import backends_are_initialized  # it has no public name

    if backends_are_initialized():
        log.warning(
            "JAX has computed in this process before: if it has several threads, trainings by SBX "
            "differ in their last digits from those of other processes"
        )
        return
    before = {name: os.environ.get(name) for name in ONE_THREAD}
    os.environ.update(ONE_THREAD)
    try:
        jax.devices()
    finally:
        for name, value in before.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value
