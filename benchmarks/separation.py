"""Ties that a poor recording leaves, and whether the next recording separates them.

    python -m benchmarks.separation [--seeds N]

On the arm, with an effect of the catalogue at a ratio of .3 to the noise, ten episodes of 30 rows
hold one actuator at a small command. Where the verdict is a tie that has the hidden effect,
`next_recording` plans as many episodes within the task's limits of commands, and lets both joints
turn as far as the task allows. They are recorded from the same
hidden robot and judged together with the first. For comparison, so are as many episodes of the
first kind. Prints each tie, and in how many of those with promised evidence it was separated: the
hidden effect is named, and nothing that the plan promised to tell from it is tied with it.
"""

import argparse
import os
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from typing import Any

import numpy as np

from adr_service.arrays import Array3
from adr_service.blind_test.planting import hide, sized_effect
from adr_service.criticism.decision import THRESHOLD
from adr_service.criticism.measurements import Measurement
from adr_service.criticism.next_recording import next_recording
from adr_service.criticism.nominal import Nominal
from adr_service.criticism.pipeline import Criticism, criticise
from adr_service.criticism.plans import Plan
from adr_service.criticism.verdict import Conclusion
from adr_service.effects.base import Effect
from adr_service.tasks.catalogue import get_task, source_of

EPISODES, ROWS, RATIO = 10, 30, 0.3
ALLOWED = {0: (-3.5, 3.5), 1: (-3.5, 3.5)}  # [rad], as the task ends an episode
_HELD = 0.3  # of the task's bounds, at most
_SEED = 77


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seeds", type=int, default=40)
    count = parser.parse_args().seeds
    with ProcessPoolExecutor(len(os.sched_getaffinity(0)), mp_context=get_context("spawn")) as pool:
        rows = [row for row in pool.map(tried, range(count)) if row is not None]
    print("| hidden | tied with | expected nats | after the plan | after more of the same |")
    print("|---|---|---|---|---|")
    for row in rows:
        names = ("hidden", "tied", "expected", "planned", "same")
        print(f"| {' | '.join(str(row[name]) for name in names)} |")
    promised = [row for row in rows if row["is_promised"]]
    for name, title in (("is_separated", "the plan"), ("is_separated_by_same", "the same again")):
        right = sum(row[name] for row in promised)
        print(f"{title}: {right} of {len(promised)} ties separated; {len(rows)} ties in all")


def tried(seed: int) -> dict[str, Any] | None:
    """The row of one seed; None without a tie that has the hidden effect."""
    task, rng = get_task("arm"), np.random.default_rng([_SEED, seed])
    nominal = Nominal.of_task(task, source_of("arm", "vanilla"))
    return separated(sized_effect(task, nominal, rng, RATIO), rng)


def separated(hidden: Effect, rng: np.random.Generator) -> dict[str, Any] | None:
    """The row of one hidden effect."""
    task = get_task("arm")
    nominal = Nominal.of_task(task, source_of("arm", "vanilla"))
    name = f"{hidden.kind} {hidden.location}"
    first = hide(task, nominal, rng, [hidden], commands=held(rng))
    criticism = criticise(nominal, first, rng, threads=1)
    if criticism.verdict.conclusion != Conclusion.TIE or name not in _names(criticism):
        return None
    limits = np.column_stack([task.action_low, task.action_high])
    seconds = ROWS * first.period()
    plan = next_recording(
        criticism, limits, rng, allowed=ALLOWED, episodes=EPISODES, seconds=seconds, threads=1
    )
    after = [
        _judged(nominal, first, hide(task, nominal, rng, [hidden], commands=commands), rng)
        for commands in (plan.commands, held(rng))
    ]
    told = set(_told_apart(plan, name))
    return {
        "hidden": name,
        "tied": ", ".join(n for n in _names(criticism) if n != name),
        "expected": ", ".join(f"{s.if_named:.0f}/{s.if_other:.0f}" for s in plan.separations),
        "planned": _words(after[0]),
        "same": _words(after[1]),
        "is_promised": bool(told),
        "is_separated": _is_separated(after[0], name, told),
        "is_separated_by_same": _is_separated(after[1], name, told),
    }


def held(rng: np.random.Generator) -> Array3:
    """Commands (EPISODES, ROWS, 2) that hold one actuator, and leave the other at rest."""
    commands = np.zeros((EPISODES, ROWS, 2))
    for episode in commands:
        episode[:, rng.integers(2)] = rng.uniform(-_HELD, _HELD)
    return commands


def _judged(
    nominal: Nominal, first: Measurement, second: Measurement, rng: np.random.Generator
) -> Criticism:
    return criticise(nominal, Measurement.joined([first, second]), rng, threads=1)


def _names(criticism: Criticism) -> list[str]:
    return [name for group in _groups(criticism) for name in group]


def _groups(criticism: Criticism) -> Iterator[list[str]]:
    """Each cause with what is tied with it."""
    verdict = criticism.verdict
    for cause, tied in zip(verdict.causes, verdict.tied, strict=True):
        yield [f"{each.kind} {each.location}" for each in (cause, *tied)]


def _told_apart(plan: Plan, hidden: str) -> Iterator[str]:
    """Effects that the plan promised to tell from the hidden one, if that is true."""
    for each in plan.separations:
        if each.named == hidden and each.if_named >= THRESHOLD:
            yield each.other
        if each.other == hidden and each.if_other >= THRESHOLD:
            yield each.named


def _is_separated(criticism: Criticism, hidden: str, told: set[str]) -> bool:
    groups = [group for group in _groups(criticism) if hidden in group]
    return len(groups) == 1 and not told & set(groups[0])


def _words(criticism: Criticism) -> str:
    named = "; ".join(" or ".join(group) for group in _groups(criticism))
    return f"{criticism.verdict.conclusion.value}: {named}" if named else "nothing"


if __name__ == "__main__":
    main()
