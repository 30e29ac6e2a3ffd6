"""What a benchmark will cost, before it runs: shared work counted once."""

import itertools
import time
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from adr_service.json_values import canonical_json
from adr_service.methods.base import OfflineSettings, OnlineSettings
from adr_service.methods.bayrn import BayRnSettings
from adr_service.methods.references import OracleSettings, PriorSettings
from adr_service.methods.simopt import SimOpt1Settings
from adr_service.methods.udr import UdrSettings
from adr_service.randomness import stream
from adr_service.simulation.batch import Simulations
from adr_service.specs import RecordedTarget, RunSpec
from adr_service.tasks.base import Task
from adr_service.tasks.catalogue import get_task, source_of, variants_of
from adr_service.training.settings import TrainingSettings

# Seconds of one gradient step on one server core: what does not shrink with the networks, and what
# grows with them, for 2x128 and batches of 256. From trainings of `hopper`, docs/training.md.
_UPDATE_S = {"sbx": (0.0005, 0.0030), "sb3": (0.0025, 0.0125)}
_REFERENCE_WORK = 256 * 128**2  # batch size x weights of the hidden layers' product
_VECTOR_STEP_S = 0.0007  # acting and storing, per step of all environments


@dataclass(frozen=True)
class Plan:
    """An estimate from the cost of its trainings, their evaluations, and the inferences.

    Trainings may stop earlier, at the reward threshold, which nobody knows before.
    """

    runs: int
    trainings: int  # distinct; equal ones are shared between runs
    environment_steps: int
    target_transitions: int  # distinct, at most
    core_hours: float
    cores: int
    hours: float | None  # with these cores, all busy; None without cores
    policies_mb: float
    basis: str = (
        "estimate, if every training uses all its steps; simulation speed measured on this "
        "machine a moment ago, gradient steps as measured on one server core"
    )


def plan(runs: Sequence[RunSpec], cores: int) -> Plan:
    """The cost of `runs` on `cores` cores."""
    trainings = {key: spec.training for spec in runs for key in _trainings(spec)}
    tasks = {key[1] for key in trainings}
    rates = {name: _step_rate(get_task(name)) for name in tasks}
    seconds = sum(_training_s(key[1], rates[key[1]], t) for key, t in trainings.items())
    searches = {key: steps for spec in runs for key, steps in _searches(spec)}
    seconds += sum(steps / rates[key[1]] for key, steps in searches.items())
    rollouts = dict(rollout for spec in runs for rollout in _rollouts(spec))
    return Plan(
        runs=len(runs),
        trainings=len(trainings),
        environment_steps=sum(t.max_steps for t in trainings.values()),
        target_transitions=sum(rollouts.values()),
        core_hours=seconds / 3600,
        cores=cores,
        hours=seconds / 3600 / cores if cores else None,
        policies_mb=sum(_policy_mb(key[1], t) for key, t in trainings.items()),
    )


Key = tuple[str, str, str]  # what, task, the rest


def _trainings(spec: RunSpec) -> Iterable[Key]:
    """Names of the distinct trainings of a run, equal where the stages will be."""
    rest = f"{spec.variant} {spec.seed} {canonical_json(spec.training.model_dump())}"
    match spec.method:
        case UdrSettings(policies=count):
            return [("udr", spec.task, f"{i} {rest}") for i in range(count)]
        case BayRnSettings(initial=count):
            udr = [("udr", spec.task, f"{i} {rest}") for i in range(count)]
            return udr + [("bayrn", spec.task, f"{i} {rest}") for i in _iterations(spec)]
        case OracleSettings():
            # trained on the vanilla variant, whatever the run's is
            return [("oracle", spec.task, rest.removeprefix(spec.variant))]
        case PriorSettings():
            return [("prior", spec.task, rest)]
        case _:
            names = [_answer(spec, i) for i in _iterations(spec)]
            if isinstance(spec.target, RecordedTarget):
                return [(name, spec.task, rest) for name in names[:1]]
            if isinstance(spec.method, OfflineSettings) and spec.collector == "simopt":
                names += [f"simopt {i}" for i in range(1, spec.iterations)]
            return [(name, spec.task, rest) for name in ["prior", *names]]


def _searches(spec: RunSpec) -> Iterable[tuple[Key, int]]:
    """Control steps that the inference of a run simulates."""
    if not isinstance(spec.method, OfflineSettings | OnlineSettings):
        return
    parameters = len(source_of(spec.task, spec.variant).space)
    for iteration in _iterations(spec)[: 1 if isinstance(spec.target, RecordedTarget) else None]:
        learned_at_once = iteration
        if isinstance(spec.method, OnlineSettings) and not isinstance(spec.method, SimOpt1Settings):
            learned_at_once = 1
        steps = spec.method.planned_steps(parameters, spec.transitions * learned_at_once)
        yield (_answer(spec, iteration), spec.task, f"{spec.variant} {spec.seed}"), steps
        if spec.simopt is not None and iteration < spec.iterations:
            steps = spec.simopt.planned_steps(parameters, spec.transitions)
            yield (f"simopt {iteration}", spec.task, f"{spec.variant} {spec.seed}"), steps


def _rollouts(spec: RunSpec) -> Iterable[tuple[tuple[str, str, int, int], int]]:
    """Names of the distinct target rollouts of a run, and their transitions at most."""
    if isinstance(spec.target, RecordedTarget):
        return
    if isinstance(spec.method, OfflineSettings | OnlineSettings):
        collector = spec.collector
        if isinstance(spec.method, OnlineSettings):
            collector = "prior" if isinstance(spec.method, SimOpt1Settings) else spec.method.name
        for iteration in range(spec.iterations):
            # the first rollout of all is of the prior's policy
            who = collector if iteration > 0 or collector == "random" else "prior"
            yield (f"{who} {spec.task}", spec.variant, spec.seed, iteration), spec.transitions
    if isinstance(spec.method, BayRnSettings):
        for episode in range(spec.method.initial + spec.iterations):
            key = (f"bayrn {spec.task}", spec.variant, spec.seed, episode)
            yield key, get_task(spec.task).horizon


def _answer(spec: RunSpec, iteration: int) -> str:
    """A name of what the method infers after `iteration` rounds of data."""
    # SimOpt's first trajectory is of the prior's policy too
    same = iteration == 1 and spec.collector == "prior"
    return f"{spec.method.name if same else spec.column} {iteration}"


def _iterations(spec: RunSpec) -> range:
    return range(1, spec.iterations + 1)


def _training_s(task_name: str, rate: float, settings: TrainingSettings) -> float:
    assert settings.backend is not None
    fixed, proportional = _UPDATE_S[settings.backend]
    work = settings.batch_size * np.prod(settings.hidden[:2]) / _REFERENCE_WORK
    rounds = settings.max_steps / settings.environments
    update = fixed + proportional * float(work)
    evaluations = -(-settings.max_steps // settings.evaluate_every)
    judged = evaluations * settings.evaluation_episodes * get_task(task_name).horizon
    updating = rounds * (settings.gradient_steps * update + _VECTOR_STEP_S)
    return (settings.max_steps + judged) / rate + updating


def _step_rate(task: Task) -> float:
    """Control steps per second of one core's time, whatever else it does; measured in .05 s."""
    source = next(iter(variants_of(task.name).values())).source
    simulations, rng = Simulations(task, source, 12), stream("step rate", task.name)
    simulations.set_dynamics(np.tile((source.space.low + source.space.high) / 2, (12, 1)))
    simulations.set_state(task.initial(12, rng))
    steps, started = 0, time.thread_time()
    while (elapsed := time.thread_time() - started) < 0.05:
        simulations.step(rng.uniform(task.action_low, task.action_high, (12, len(task.action_low))))
        steps += 12
    return steps / elapsed


def _policy_mb(task_name: str, settings: TrainingSettings) -> float:
    task = get_task(task_name)
    widths = [len(task.columns), *settings.hidden, len(task.action_low)]
    weights = sum((a + 1) * b for a, b in itertools.pairwise(widths))
    return 4 * weights / 1e6
