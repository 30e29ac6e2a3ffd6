"""Machines for `adr robot`: an arm in simulation that takes its time, as a real one does."""

import time

import numpy as np

from adr_service.simulation.gym_env import RandomizedEnv

# a user's own module `my_robot`, for `my_robot:make`
MODULE = "import adr_service, gymnasium\nmake = lambda: gymnasium.make('adr/RandomArmNoisy-v0')\n"


class SlowArm(RandomizedEnv):
    """The arm of the noisy variant, at its own pace."""

    def __init__(self, pause_s=0.01):
        super().__init__("arm", "noisy")
        self.pause_s, self.actions, self.step_times = pause_s, [], []

    def step(self, action):
        time.sleep(self.pause_s)
        self.actions.append(action)
        self.step_times.append(time.monotonic())
        return super().step(action)


class BlindArm(SlowArm):
    """Its sensors fail after ten steps."""

    def step(self, action):
        observation, *rest = super().step(action)
        return observation * (np.nan if len(self.actions) > 10 else 1.0), *rest


class NarrowArm(SlowArm):
    """Shows one number fewer than it declares."""

    def reset(self, **given):
        observation, info = super().reset(**given)
        return observation[:-1], info


class StuckArm(SlowArm):
    """Its driver hangs, in the sixth step or at once."""

    def __init__(self, hangs_in):
        super().__init__()
        self.hangs_in = hangs_in

    def reset(self, **given):
        if self.hangs_in == "reset":
            time.sleep(3600)
        return super().reset(**given)

    def step(self, action):
        if len(self.actions) > 5:
            time.sleep(3600)
        return super().step(action)


class CutArm(SlowArm):
    """Is stopped after five steps."""

    def step(self, action):
        observation, reward, terminated, truncated, info = super().step(action)
        return observation, reward, terminated, truncated or len(self.actions) == 5, info


class BreakingArm(SlowArm):
    """Its driver raises in the third step; counts how often it was closed."""

    last = None

    def __init__(self):
        super().__init__(0.0)
        self.closed = 0
        type(self).last = self

    def step(self, action):
        if len(self.actions) == 2:
            raise RuntimeError("the bus is gone")
        return super().step(action)

    def close(self):
        self.closed += 1
        super().close()


def cut_arm():
    return CutArm(0.0)


def breaking_arm():
    return BreakingArm()


def sleepy_arm():
    return SlowArm(0.05)


def stuck_arm():
    return StuckArm("step")


def stuck_reset():
    return StuckArm("reset")


def narrow_arm():
    return NarrowArm(0.0)


def blind_arm():
    return BlindArm(0.0)


def fast_arm():
    return SlowArm(0.0)


def slowest_arm():
    return SlowArm(0.03)


def slow_arm():
    return SlowArm(0.02)


def not_an_environment():
    return object()
