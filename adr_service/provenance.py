"""Versions and CPU type that the numbers of this process come from.

Results are equal to the byte where these are.
"""

import importlib.metadata
import platform
from pathlib import Path

_PACKAGES = (
    *("adr-service", "mujoco", "numpy", "scipy", "cma"),
    *("stable-baselines3", "torch", "sbx-rl", "jax"),
)


def provenance() -> dict[str, str]:
    """Return versions by package, and Python's, and the model of the CPU."""
    installed = {d.name: d.version for d in importlib.metadata.distributions()}
    versions = {name: installed[name] for name in _PACKAGES if name in installed}
    return {"python": platform.python_version(), "cpu": _cpu_model(), **versions}


def _cpu_model() -> str:
    cpuinfo = Path("/proc/cpuinfo")
    lines = cpuinfo.read_text().splitlines() if cpuinfo.exists() else []
    models = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    return models[0] if models else platform.processor()
