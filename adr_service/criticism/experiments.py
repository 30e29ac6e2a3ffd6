"""The experiment that best separates two explanations of the same data.

Each is simple: one actuator moves, the others rest, from postures that the recording has. The best
is the one on which the two fitted simulators differ most, in units of the one-step error that noise
and misfit let expect. What the recorded episodes give stands beside it, so that a reader sees
whether it is worth the effort. Steps at which either simulation has diverged are not counted.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from adr_service.arrays import Matrix, Vector
from adr_service.criticism.evidence import expected_errors
from adr_service.criticism.fits import Fit
from adr_service.criticism.measurements import Measurement
from adr_service.criticism.simulator import Simulator
from adr_service.criticism.verdict import Experiment

_STEPS = 50  # control steps of an experiment
_POSTURES = 3
_CYCLES = (0.0, 1.0, 5.0)  # of a sine during an experiment; 0: held


@dataclass(frozen=True)
class _Trial:
    """Commands of one experiment, from the state of one recorded row."""

    start: int  # row
    commands: Matrix  # (_STEPS, nu)
    description: str


def separating_experiment(one: Fit, other: Fit) -> Experiment:
    """The experiment that best separates the effects of two fits to the same data."""
    fits, recorded = (one, other), one.simulator
    unit = expected_errors(one)
    trials = _trials(recorded)
    data = _measurement(recorded, trials)
    with Simulator(recorded.nominal, data, threads=1, finer=recorded.finer) as tried:
        apart = _apart(tried, fits, unit)
    best = int(np.argmax(apart))
    return Experiment(
        trials[best].description,
        separation=float(apart[best]),
        recorded=float(np.sqrt(np.mean(_apart(recorded, fits, unit) ** 2))),
    )


def _apart(simulator: Simulator, fits: tuple[Fit, Fit], unit: Vector) -> Vector:
    """(episodes,) root mean square difference between two fits' predictions of whole episodes."""
    one, other = (simulator.follow(fit.parameters, fit.effects) for fit in fits)
    measured = np.isfinite(unit)
    square = np.mean(((one - other) / unit)[:, measured] ** 2, axis=1)
    episodes = [square[first + 1 : last] for first, last in simulator.data.spans()]
    known = [each[np.isfinite(each)] for each in episodes]
    return np.sqrt([each.mean() if len(each) else 0.0 for each in known])


def _trials(simulator: Simulator) -> list[_Trial]:
    """All motions, each from all postures."""
    seconds = _STEPS * simulator.period
    postures = [first for first, _ in simulator.data.spans()[:_POSTURES]]
    return [
        _Trial(
            start,
            commands,
            f"from the state of row {start}, {motion}, others at rest, for {seconds:.2g} s",
        )
        for commands, motion in _motions(simulator)
        for start in postures
    ]


def _motions(simulator: Simulator) -> Iterator[tuple[Matrix, str]]:
    """Commands (_STEPS, nu) within those recorded, and their description."""
    recorded = simulator.data.ctrl[simulator.starts]
    low, high = recorded.min(axis=0), recorded.max(axis=0)
    phase = 2 * np.pi * np.arange(_STEPS) / _STEPS
    rest = np.clip(np.zeros_like(low), low, high)
    for actuator in range(len(low)):
        name = simulator.base.actuator(actuator).name
        for cycles in _CYCLES:
            how = f"as a sine of {cycles / (_STEPS * simulator.period):.2g} Hz from"
            for end, extreme in ((high, "highest"), (low, "lowest")):
                wave = np.cos(cycles * phase)[:, None]
                commands = np.tile(rest, (_STEPS, 1))
                commands[:, actuator] = rest[actuator] + wave[:, 0] * (end - rest)[actuator]
                yield (
                    np.clip(commands, low, high),
                    f"move actuator:{name} {how if cycles else 'and hold it at'} its {extreme} "
                    "recorded command",
                )
    yield np.tile(rest, (_STEPS, 1)), "command nothing"


def _measurement(simulator: Simulator, trials: list[_Trial]) -> Measurement:
    """Commands and first states of trials, as a recording of nothing else."""
    data, count = simulator.data, len(trials)
    first = np.zeros((_STEPS, 1))
    return Measurement(
        time=np.tile(np.arange(_STEPS, dtype=np.float64) * simulator.period, count),
        qpos=np.concatenate([first + data.qpos[trial.start] for trial in trials]),
        qvel=np.concatenate([first + data.qvel[trial.start] for trial in trials]),
        ctrl=np.concatenate([trial.commands for trial in trials]),
        episode=np.repeat(np.arange(count), _STEPS),
    )
