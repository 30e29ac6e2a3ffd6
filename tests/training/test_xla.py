"""Threads of JAX, in processes of their own: it chooses them once."""

import os
import subprocess
import sys

import pytest

from adr_service.training.xla import ONE_THREAD

pytest.importorskip("jax")
COMPUTING = """
import os
import jax.numpy as jnp
from adr_service.training.libraries import jax_activation
{first}
before = dict(os.environ)
jax_activation("relu")
assert dict(os.environ) == before
jnp.dot(jnp.ones((300, 300)), jnp.ones((300, 300))).block_until_ready()
threads = [open(f"/proc/self/task/{{t}}/comm").read() for t in os.listdir("/proc/self/task")]
print(sum(name.startswith("tf_XLAEigen") for name in threads))
"""


def computing(first):
    """The threads that compute, and what is said, where a process does this first."""
    inherited = {name: value for name, value in os.environ.items() if name not in ONE_THREAD}
    done = subprocess.run(
        [sys.executable, "-c", COMPUTING.format(first=first)],
        env={**inherited, "NPROC": "3", "JAX_PLATFORMS": "cpu"},
        capture_output=True,
        text=True,
        check=True,
    )
    return int(done.stdout), done.stderr


def test_jax_computes_on_one_thread():
    """Two threads gave trainings other last digits."""
    assert computing("") == (1, "")


@pytest.mark.slow
def test_a_process_in_which_jax_has_computed_before_says_what_that_may_change():
    threads, said = computing("jnp.ones(3).block_until_ready()")
    assert threads == 3
    assert "JAX has computed in this process before" in said
