"""The names under which Gymnasium finds our tasks: `import adr_service` registers them."""

import gymnasium

from adr_service.tasks.catalogue import BUILT_IN

_SUFFIXES = {"vanilla": "", "noisy": "Noisy", "unmodeled": "Unmodeled"}


def register() -> None:
    """`adr/RandomHopper-v0`, `adr/RandomHopperNoisy-v0`, and so on."""
    for name, entry in BUILT_IN.items():
        robot = "".join(word.capitalize() for word in name.split("_"))
        for variant in entry.variants:
            gymnasium.register(
                id=f"adr/Random{robot}{_SUFFIXES[variant]}-v0",
                entry_point="adr_service.simulation.gym_env:RandomizedEnv",
                max_episode_steps=entry.task.horizon,
                kwargs={"task": name, "variant": variant},
            )
