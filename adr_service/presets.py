"""Named budgets, from seconds to weeks: defaults for all fields that a spec leaves out.

- `smoke`: hundreds of steps, for tests. Its numbers mean nothing.
- `demo`: minutes, for the task `arm`: policies of 65,536 steps.
- `quick`: a first look at a task, in half an hour to three hours on two cores: the trainings of
  `fast`, two iterations in the place of five, and smaller searches.
- `fast`: the benchmark's protocol (Tiboni et al., Sec. 3.4), with trainings that need little CPU
  time (docs/training.md).
- `paper`: the same protocol with the published trainings.

`trainings` has the training of tasks that need one of their own.
"""

from typing import Any

# found by single trainings on the truths of the four tasks (docs/decisions.md)
_FAST: dict[str, Any] = {
    "algorithm": "ppo",
    "max_steps": 4_000_000,
    "evaluate_every": 65_536,
}
_FAST_TRAININGS: dict[str, dict[str, Any]] = {
    "hopper": {
        **_FAST,
        "max_steps": 3_000_000,
        "environments": 64,
        "rollout_steps": 64,
        "learning_rate": 0.0003,
        "action_bins": 5,  # Gaussian policies stay in a slow gait more often,
        "entropy_coefficient": 0.015,  # and so do those without this bonus
        "averaged_steps": 20_000,
    },
    "half_cheetah": {
        **_FAST,
        "max_steps": 12_000_000,
        "hidden": [256, 256],
        "learning_rate_schedule": "linear",  # a constant one is unsteady above 4000
        "epochs": 5,  # more, and it stops exploring before it runs
        "gamma": 0.98,  # a control period is six of Hopper's
        "log_deviation": -0.7,
        "averaged_steps": 20_000,
        "evaluate_every": 131_072,
    },
    "walker2d": {**_FAST, "averaged_steps": 20_000},
    "humanoid": {
        "algorithm": "crossq",
        "max_steps": 1_000_000,
        "hidden": [256, 256],
        "critic_hidden": [256, 256],
        "averaged_steps": 6000,
        "evaluate_every": 10_000,
    },
}


_EXTENDED = {  # methods by those whose searches they share
    "simopt": ("simopt_memory",),
    "droid": ("droid_smoothed",),
    "dropo": ("dropo_smoothed", "e_dropo"),
    "sysid": ("sysid_smoothed", "sysid_wide", "sysid_laplace"),
}


def _with_extensions(searches: dict[str, Any]) -> dict[str, Any]:
    """Settings of methods, and the same for the extensions of them."""
    extended = {
        extension: dict(search)
        for name, search in searches.items()
        for extension in _EXTENDED.get(name, ())
    }
    return {**searches, **extended}


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
        "methods": _with_extensions(
            {
                "udr": {"policies": 2},
                "bayrn": {"initial": 2},
                # a full covariance needs more samples than Humanoid has parameters
                "simopt": {"updates": 2, "samples": 40},
                "simopt_1": {"updates": 3, "samples": 40},
                "droid": {"budget": 30},
                "dropo": {"budget": 4, "samples_per_parameter": 3, "epsilon": 1e-4},
                "sysid": {"starts": 1, "iterations": 3},
                "bayes_sim": {"simulations": 40, "epochs": 10},
                "npdr": {"rounds": 2, "simulations": 40, "epochs": 10, "draws": 20},
            }
        ),
    },
    "demo": {
        "run": {
            "iterations": 2,
            "transitions": 200,
            "evaluation_episodes": 50,
            "training": {
                "algorithm": "ppo",
                "max_steps": 65_536,
                "rollout_steps": 64,
                "hidden": [64, 64],
                "learning_rate": 0.001,
                "evaluate_every": 8192,
            },
        },
        "methods": _with_extensions(
            {
                "udr": {"policies": 3},
                "bayrn": {"initial": 3},
                "simopt": {"samples": 500},
                "simopt_1": {"samples": 500},
                "droid": {"budget": 500},
                "dropo": {"samples_per_parameter": 4, "epsilon": 1e-4},
            }
        ),
    },
    "quick": {
        "run": {
            "iterations": 2,
            "transitions": 200,
            "evaluation_episodes": 50,
            "training": _FAST,
        },
        "trainings": _FAST_TRAININGS,
        "methods": _with_extensions(
            {
                "udr": {"policies": 3},
                "bayrn": {"initial": 3},
                "simopt": {"samples": 300},
                "simopt_1": {"samples": 300},
                "droid": {"budget": 500},
                "dropo": {"epsilon": [1e-5, 1e-4, 1e-3]},
            }
        ),
    },
    "fast": {
        "run": {
            "iterations": 5,
            "transitions": 200,
            "evaluation_episodes": 100,
            "training": _FAST,
        },
        "trainings": _FAST_TRAININGS,
        "methods": {},
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
