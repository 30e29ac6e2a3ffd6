"""What to know of the data, and which experiment would tell two explanations apart.

Of a list of simple experiments (one actuator moved, the others at rest, from postures that the
recording has), the one on which the two fitted simulators differ most, in units of the error that
noise and misfit let expect of one step; beside what the recorded episodes give, so that a reader
sees whether it is worth the effort. Steps at which either simulation has diverged are not counted.
"""

import mujoco
import numpy as np

from adr_service.arrays import Matrix, Vector
from adr_service.criticism.evidence import Fit, expected_errors
from adr_service.criticism.measurements import Measurement
from adr_service.criticism.simulator import Simulator
from adr_service.criticism.verdict import Experiment

_STEPS = 50  # control steps of an experiment
_POSTURES = 3
_CYCLES = (0.0, 1.0, 5.0)  # of a sine during an experiment; 0: held


def remarks(model: mujoco.MjModel, data: Measurement) -> tuple[str, ...]:
    """On commands that say little, or that the simulator does not obey to the letter."""
    told = data.ctrl[:-1][np.diff(data.episode) == 0]  # the last row of an episode commands nothing
    found: list[str] = []
    for number, values in enumerate(told.T):
        name = model.actuator(number).name
        if np.ptp(values) == 0:
            found.append(
                f"Actuator {name} is told {values[0]:g} all the time: of what it does with other "
                "commands these data say nothing."
            )
        low, high = model.actuator_ctrlrange[number]
        beyond = int(np.sum((values < low) | (values > high)))
        if model.actuator_ctrllimited[number] and beyond:
            found.append(
                f"{beyond} of {len(values)} commands to actuator {name} are beyond its limits, "
                f"{low:g} to {high:g}; the simulator obeys the limits, as MuJoCo does."
            )
    return tuple(found)


def separating_experiment(one: Fit, other: Fit) -> Experiment:
    """What to do with the robot, to tell the causes of two fits to the same data apart."""
    fits, recorded = (one, other), one.simulator
    unit = expected_errors(one)
    data, descriptions = _experiments(recorded)
    with Simulator(recorded.nominal, data, threads=1, finer=recorded.finer) as tried:
        apart = _apart(tried, fits, unit)
    best = int(np.argmax(apart))
    return Experiment(
        descriptions[best],
        separation=float(apart[best]),
        recorded=float(np.sqrt(np.mean(_apart(recorded, fits, unit) ** 2))),
    )


def _apart(simulator: Simulator, fits: tuple[Fit, Fit], unit: Vector) -> Vector:
    """(episodes,) root mean square difference of what two fits predict of whole episodes."""
    one, other = (simulator.follow(fit.parameters, fit.causes) for fit in fits)
    measured = np.isfinite(unit)
    square = np.mean(((one - other) / unit)[:, measured] ** 2, axis=1)
    episodes = [square[first + 1 : last] for first, last in simulator.data.spans()]
    known = [each[np.isfinite(each)] for each in episodes]
    return np.sqrt([each.mean() if len(each) else 0.0 for each in known])


def _experiments(simulator: Simulator) -> tuple[Measurement, list[str]]:
    """Commands and first states, as a recording of nothing else."""
    data, model = simulator.data, simulator.base
    low, high = data.ctrl.min(axis=0), data.ctrl.max(axis=0)
    starts = [first for first, _ in data.spans()[:_POSTURES]]
    phase = 2 * np.pi * np.arange(_STEPS) / _STEPS
    commands: list[Matrix] = []
    said: list[str] = []
    rest = np.clip(np.zeros_like(low), low, high)
    for actuator in range(len(low)):
        for cycles in _CYCLES:
            for end, name in ((high, "highest"), (low, "lowest")):
                wave = np.cos(cycles * phase)[:, None]
                told = np.tile(rest, (_STEPS, 1))
                told[:, actuator] = rest[actuator] + wave[:, 0] * (end - rest)[actuator]
                commands.append(np.clip(told, low, high))
                how = f"as a sine of {cycles / (_STEPS * simulator.period):.2g} Hz from"
                said.append(
                    f"move actuator:{model.actuator(actuator).name} "
                    f"{how if cycles else 'and hold it at'} its {name} recorded command"
                )
    commands.append(np.tile(rest, (_STEPS, 1)))
    said.append("command nothing")
    tried = [(c, s, start) for c, s in zip(commands, said, strict=True) for start in starts]
    first = np.zeros((_STEPS, 1))
    measurement = Measurement(
        time=np.tile(np.arange(_STEPS, dtype=np.float64) * simulator.period, len(tried)),
        qpos=np.concatenate([first + data.qpos[start] for _, _, start in tried]),
        qvel=np.concatenate([first + data.qvel[start] for _, _, start in tried]),
        ctrl=np.concatenate([told for told, _, _ in tried]),
        episode=np.repeat(np.arange(len(tried)), _STEPS),
    )
    return measurement, [
        f"from the state of row {start}, {what}, others at rest, for "
        f"{_STEPS * simulator.period:.2g} s"
        for _, what, start in tried
    ]
