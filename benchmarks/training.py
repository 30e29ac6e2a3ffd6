"""Environment steps per second of policy training: stock SB3, and ours with both backends.

Hopper with the `paper` preset's hyperparameters (SAC, 2x128 tanh, batches of 256, one update per
step of 12 environments). Each subject trains in a process of its own, side by side in one run:
medians of three interleaved rounds, after imports, compilation and a thousand steps to warm up.

    python benchmarks/training.py [environment steps per measurement, 6000]

`stock` is SB3's SAC on Gymnasium's Hopper-v5 in a SubprocVecEnv of 12 processes, with PyTorch's own
number of threads; `sb3` and `sbx` are ours on the randomised batch, as the service's workers run
them: one thread. Writes
build/bench/training.json: subject -> {env_steps_per_s, updates_per_s, cores}, where cores are CPU
seconds of the process and its children per second.
"""

import json
import os
import statistics
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import psutil

from workers.cluster import worker_environment

FOLDER = Path("build/bench")
SUBJECTS = ("stock", "sb3", "sbx")
ROUNDS, WARM_UP, ENVIRONMENTS = 3, 1200, 12
TARGET = 5.0  # times stock's environment steps per CPU second


def main() -> None:
    steps = int(sys.argv[1]) if len(sys.argv) > 1 else 6000
    found: dict[str, list[dict[str, float]]] = {subject: [] for subject in SUBJECTS}
    for _ in range(ROUNDS):
        for subject, measured in found.items():
            measured.append(in_a_process_of_its_own(subject, steps))
    result = {
        subject: {name: statistics.median(m[name] for m in measured) for name in measured[0]}
        for subject, measured in found.items()
    }
    FOLDER.mkdir(parents=True, exist_ok=True)
    (FOLDER / "training.json").write_text(json.dumps(result, indent=1))
    stock = result["stock"]["env_steps_per_s"] / result["stock"]["cores"]
    for subject, rates in result.items():
        per_core = rates["env_steps_per_s"] / rates["cores"]
        numbers = ", ".join(f"{name} {value:.4g}" for name, value in rates.items())
        print(
            f"{subject}: {numbers}; {per_core:.0f} per CPU second, {per_core / stock:.1f} x stock"
        )
    ratio = result["sbx"]["env_steps_per_s"] / result["sbx"]["cores"] / stock
    print(f"sbx / stock: {ratio:.1f}, target {TARGET}" + ("" if ratio >= TARGET else "  MISSED"))


def in_a_process_of_its_own(subject: str, steps: int) -> dict[str, float]:
    environment = dict(os.environ)
    if subject != "stock":
        environment |= worker_environment(FOLDER.absolute() / "jax")
    command = [sys.executable, __file__, subject, str(steps)]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
    if done.returncode:
        raise SystemExit(done.stderr)
    return json.loads(done.stdout.splitlines()[-1])


class Meter:
    """Called after every step of all environments; measures those after the warm-up."""

    def __init__(self, steps: int):
        self._last, self._started = WARM_UP + steps, (0, 0.0, 0.0)
        self.result: dict[str, float] | None = None

    def __call__(self, done: int) -> None:
        if done < WARM_UP or self.result is not None:
            return
        if self._started[0] == 0:
            self._started = (done, time.perf_counter(), cpu_seconds())
        elif done >= self._last:
            first, at, cpu = self._started
            seconds = time.perf_counter() - at
            rate = (done - first) / seconds
            self.result = {
                "env_steps_per_s": rate,
                "updates_per_s": rate / ENVIRONMENTS,
                "cores": (cpu_seconds() - cpu) / seconds,
            }


def cpu_seconds() -> float:
    """CPU seconds of this process and its children, living or not."""
    me = psutil.Process()
    times = [p.cpu_times() for p in (me, *me.children(recursive=True))]
    return sum(t.user + t.system for t in times)


def stock(meter: Meter, steps: int) -> None:
    import gymnasium
    import torch
    from stable_baselines3 import SAC
    from stable_baselines3.common.callbacks import BaseCallback
    from stable_baselines3.common.vec_env import SubprocVecEnv

    class Watch(BaseCallback):
        def _on_step(self) -> bool:
            meter(self.num_timesteps)
            return True

    env = SubprocVecEnv([lambda: gymnasium.make("Hopper-v5")] * ENVIRONMENTS)
    kwargs: dict[str, Any] = {"net_arch": [128, 128], "activation_fn": torch.nn.Tanh}
    model = SAC("MlpPolicy", env, learning_rate=5e-4, policy_kwargs=kwargs, device="cpu")
    model.learn(WARM_UP + steps + ENVIRONMENTS, callback=Watch())
    env.close()


def ours(backend: str, meter: Meter, steps: int) -> None:
    import numpy as np

    from adr_service.distributions import Gaussian
    from adr_service.specs import RunSpec
    from adr_service.tasks.catalogue import get_task, source_of
    from adr_service.training.train import train

    most = WARM_UP + steps + ENVIRONMENTS
    given = {
        "backend": backend,
        "max_steps": most,
        "evaluate_every": most,
        "evaluation_episodes": 2,
    }
    spec = RunSpec.model_validate(
        {"task": "hopper", "method": "prior", "preset": "paper", "training": given}
    )
    source = source_of("hopper", "vanilla")
    rng = np.random.default_rng(0)

    def progress(fraction: float, **facts: Any) -> None:
        meter(facts["steps"])

    prior = Gaussian.prior(source.space)
    train(get_task("hopper"), source, prior, spec.training, rng, progress=progress)


def measure(subject: str, steps: int) -> dict[str, float]:
    meter = Meter(steps)
    if subject == "stock":
        stock(meter, steps)
    else:
        ours(subject, meter, steps)
    assert meter.result is not None
    return meter.result


if __name__ == "__main__":
    if sys.argv[1:2] and sys.argv[1] in SUBJECTS:
        print(json.dumps(measure(sys.argv[1], int(sys.argv[2]))))
    else:
        main()
