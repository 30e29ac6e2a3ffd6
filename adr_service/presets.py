"""Named budgets, from seconds to weeks: defaults for all fields that a spec leaves out.

- `smoke`: hundreds of steps, for tests. Its numbers mean nothing.
- `demo`: minutes, for the task `arm`: policies of 40,000 steps.
- `quick`: a seed of one task in under an hour on two cores; shorter trainings, smaller searches.
- `paper`: the benchmark's protocol (Tiboni et al., Sec. 3.2 and 3.4).
"""

from typing import Any

PRESETS: dict[str, dict[str, Any]] = {
    "smoke": {
        "run": {
            "iterations": 1,
            "transitions": 20,
            "evaluation_episodes": 4,
            "training": {
                "backend": "sb3",  # compiles nothing, so it starts soonest
                "max_steps": 600,
                "hidden": [16, 16],
                "activation": "relu",
                "batch_size": 32,
                "evaluate_every": 300,
                "evaluation_episodes": 4,
            },
        },
        "methods": {
            "udr": {"policies": 2},
            "bayrn": {"initial": 2},
            "simopt": {"updates": 2, "samples": 20},
            "simopt_1": {"updates": 3, "samples": 20},
            "droid": {"budget": 30},
            "dropo": {"budget": 20, "samples_per_parameter": 3, "epsilon": 1e-4},
            "sysid": {"starts": 1, "iterations": 3},
        },
    },
    "demo": {
        "run": {
            "iterations": 2,
            "transitions": 200,
            "evaluation_episodes": 50,
            "training": {
                "max_steps": 40_000,
                "gradient_steps": 6,
                "hidden": [64, 64],
                "activation": "relu",
                "batch_size": 128,
                "learning_starts": 1000,
                "evaluate_every": 2500,
                "evaluation_episodes": 24,
            },
        },
        "methods": {
            "udr": {"policies": 3},
            "bayrn": {"initial": 3},
            "simopt": {"samples": 500},
            "simopt_1": {"samples": 500},
            "droid": {"budget": 500},
            "dropo": {"budget": 800, "samples_per_parameter": 4, "epsilon": 1e-4},
        },
    },
    "quick": {
        "run": {
            "iterations": 2,
            "transitions": 200,
            "evaluation_episodes": 50,
            "training": {
                # by a few trainings on Hopper (docs/training.md); updates take nearly all time
                "max_steps": 120_000,
                "gradient_steps": 12,
                "learning_rate": 0.001,
                "hidden": [128, 128],
                "activation": "relu",
                "batch_size": 128,
                "learning_starts": 2000,
                "evaluate_every": 5000,
                "evaluation_episodes": 24,
            },
        },
        "methods": {
            "udr": {"policies": 3},
            "bayrn": {"initial": 3},
            "simopt": {"samples": 300},
            "simopt_1": {"samples": 300},
            "droid": {"budget": 500},
            "dropo": {"budget": 1500, "epsilon": [1e-5, 1e-4, 1e-3]},
        },
    },
    "paper": {
        "run": {
            "iterations": 5,
            "transitions": 200,
            "evaluation_episodes": 100,
            "training": {},  # TrainingSettings' defaults
        },
        "methods": {},  # the methods' own defaults
    },
}
