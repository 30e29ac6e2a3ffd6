"""Versions and CPU type that the numbers of this process come from.

Results are equal to the byte where these are.
"""

import importlib.metadata
import platform
from collections.abc import Mapping
from pathlib import Path

_PACKAGES = (
    *("adr-service", "mujoco", "numpy", "scipy", "cma"),
    *("stable-baselines3", "sb3-contrib", "torch", "botorch", "gpytorch", "sbi", "zuko"),
    *("sbx-rl", "jax", "jaxlib", "flax", "optax"),
)


_OF_CPU = ("model name", "cpu family", "model")  # a name alone may stand for several generations


def provenance() -> dict[str, str]:
    """Return versions by package, and Python's, and the type of the CPU."""
    found = importlib.metadata.distributions()
    # stable_baselines3 is installed by another name, and a broken package has none
    installed = {(each.name or "").replace("_", "-"): each.version for each in found}
    versions = {name: installed[name] for name in _PACKAGES if name in installed}
    return {"python": platform.python_version(), "cpu": _cpu_type(), **versions}


def has_same_provenance(stored: Mapping[str, str], here: Mapping[str, str]) -> bool:
    """True if a result's provenance is that of this process, in all that was noted with it.

    Older results note fewer packages.
    """
    return bool(stored) and stored.items() <= here.items()


def _cpu_type() -> str:
    file = Path("/proc/cpuinfo")
    return cpu_type(file.read_text()) if file.exists() else platform.processor()


def cpu_type(cpuinfo: str) -> str:
    """Name, family and model of the first CPU in `/proc/cpuinfo`, or the name alone."""
    lines = cpuinfo.split("\n\n", maxsplit=1)[0].splitlines()
    pairs = (line.partition(":")[::2] for line in lines)
    facts = {name.strip(): value.strip() for name, value in pairs}
    if not all(name in facts for name in _OF_CPU):
        return facts.get("model name", platform.processor())
    name, family, model = (facts[name] for name in _OF_CPU)
    return f"{name}, family {family}, model {model}"
