"""Settings of trainings that take a second."""

from pydantic import TypeAdapter

from adr_service.training.settings import TrainingSettings

TINY = {
    "max_steps": 480,
    "hidden": [16, 16],
    "batch_size": 32,
    "evaluate_every": 240,
    "evaluation_episodes": 4,
}
_OTHERS = {
    "sac": {},
    "crossq": {"critic_hidden": [16, 16], "confirmation_episodes": 6, "learning_starts": 100},
    "ppo": {
        "environments": 12,
        "rollout_steps": 8,
        "epochs": 2,
        "confirmation_episodes": 6,
    },
}


def settings(algorithm="sac", backend="sb3", **others):
    """Settings of an algorithm; `others` are those that are not as in `TINY`."""
    given = {"algorithm": algorithm, "backend": backend, **TINY, **_OTHERS[algorithm]}
    return TypeAdapter(TrainingSettings).validate_python({**given, **others})
