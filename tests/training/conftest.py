"""Trainings by JAX compile the same functions again and again."""

import importlib.util
import os

import pytest


@pytest.fixture(scope="session", autouse=True)
def compile_cache(request, tmp_path_factory):
    """Compiled functions are kept for the session, as the service's workers keep them.

    Its processes share them. Compiling takes longer than a training of the fast tests, so it
    optimises little for them.
    """
    if importlib.util.find_spec("jax") is None:
        return
    import jax

    folder = tmp_path_factory.getbasetemp()
    if "PYTEST_XDIST_WORKER" in os.environ:  # whose folder lies in that of all processes
        folder = folder.parent
    only_fast = request.config.option.markexpr == "not slow"
    jax.config.update("jax_disable_most_optimizations", only_fast)
    jax.config.update("jax_compilation_cache_dir", str(folder / "jax"))
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0)
    jax.config.update("jax_persistent_cache_min_entry_size_bytes", -1)
