"""Blind test of criticism: effects hidden in measurements, and whether they are named.

    python -m benchmarks.criticism [cases, 320] [tasks, arm,hopper,half_cheetah,walker2d] [seed, 12]

The cases are those of `adr criticise-bench make` with the same seed. Every measurement has 30
episodes of 75 control steps. As many processes at once as there are cores, each with one thread
(set OMP_NUM_THREADS=1). Writes build/bench/criticism.json after every case, and goes on from there
where it was interrupted, while the method is the same.
"""

import json
import sys
import time
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from adr_service.blind_test.cases import Hidden, draw_blind
from adr_service.blind_test.files import Answer
from adr_service.blind_test.planting import Case
from adr_service.blind_test.scoring import Marked, is_named, score, share
from adr_service.criticism.gain import share_removed
from adr_service.criticism.pipeline import Criticism, criticise, split
from benchmarks.ended_cases import all_cases, digest_of

PATH = Path("build/bench/criticism.json")
METHOD = ("criticism", "effects", "simulation", "blind_test")  # packages


def one(job: tuple[int, str, int]) -> dict[str, Any]:
    """One case with what was hidden and what criticism named, or with the error that ended it."""
    number, task, seed = job
    rng = np.random.default_rng([seed, number])
    hidden, case = draw_blind(task, rng)
    ended = {"number": number, "hidden": hidden.model_dump(mode="json")}
    started = time.process_time()
    try:
        criticism = criticise(case.nominal, case.measurement, rng, threads=1)
        seconds = time.process_time() - started
        return {**ended, **_compared(case, criticism, seconds)}
    except Exception as error:  # noqa: BLE001 - the others go on; the table counts it
        return {**ended, "failed": f"{type(error).__name__}: {error}"}


def _compared(case: Case, criticism: Criticism, seconds: float) -> dict[str, Any]:
    """The verdict, and what the hidden effects themselves would have gained."""
    verdict = criticism.verdict.to_json()
    oracle = None if criticism.verdict.gain is None else _oracle(case, criticism)
    detectable = verdict["residual"].pop("detectable")
    return {
        "answer": {**verdict, "cpu_seconds": seconds},
        "detectable": [detectable.get(f"{c.kind} {c.location}") for c in case.effects],
        "ranking": [[c.kind, c.location, c.gain] for c in criticism.candidates[:6]],
        "oracle": oracle,
    }


def _oracle(case: Case, criticism: Criticism) -> dict[str, float]:
    """Share of squared innovations that the true parameters and effects remove, on the same
    episodes, and the lower end of its interval."""
    truth = replace(criticism.final, parameters=case.truth, effects=case.effects)
    sealed = split(case.measurement)[1]
    removed, low, _ = share_removed(criticism.baseline, truth, sealed, threads=1)
    return {"sse_removed": removed, "low": low}


def _marked(case: dict[str, Any]) -> Marked:
    answer = Answer.model_validate_json(json.dumps(case["answer"])) if "answer" in case else None
    return Marked(Hidden.model_validate_json(json.dumps(case["hidden"])), answer)


def table(cases: Sequence[dict[str, Any]]) -> str:
    """The score of all cases, that by each record's own limit, by task with its cost, and gains."""
    lines = [f"{name}: {value}" for name, value in score([_marked(c) for c in cases]).items()]
    return "\n".join([*lines, *_by_limit(cases), *_by_task(cases), *_gains(cases)])


def _by_limit(cases: Sequence[dict[str, Any]]) -> Iterator[str]:
    """Shares of named effects, of those that their own record can show and of those it cannot."""
    above, below = [], []
    for case in cases:
        hidden = case["hidden"]
        if "failed" in case or hidden["kind"] != "one" or hidden["ratio"] < 0.1:
            continue
        (limit,), strength = case["detectable"], hidden["effects"][0]["values"][0]
        if limit is not None:
            (above if abs(strength) >= limit["value"] else below).append(_marked(case))
    for where, chosen in (("above", above), ("below", below)):
        yield (
            f"one effect, ratio 0.1 or above, {where} its record's own limit: "
            f"{share(chosen, is_named)}"
        )


def _by_task(cases: Sequence[dict[str, Any]]) -> Iterator[str]:
    for task in sorted({case["hidden"]["task"] for case in cases}):
        own = [case for case in cases if case["hidden"]["task"] == task]
        one = [_marked(case) for case in own if case["hidden"]["kind"] == "one"]
        strong = [case for case in one if case.hidden.ratio >= 0.1]
        yield f"{task}: one effect, ratio 0.1 or above: {share(strong, is_named)}"
        seconds = [case["answer"]["cpu_seconds"] for case in own if "answer" in case]
        if seconds:
            yield f"{task}: CPU seconds, median: {np.median(seconds):.0f}"


def _gains(cases: Sequence[dict[str, Any]]) -> Iterator[str]:
    right = [c for c in cases if c["hidden"]["kind"] == "one" and is_named(_marked(c))]
    seen = [c for c in right if c["oracle"] is not None and c["oracle"]["low"] > 0]
    if shares := [c["answer"]["gain"]["sse_removed"] / c["oracle"]["sse_removed"] for c in seen]:
        most = sum(s >= 0.95 for s in shares)
        yield (
            f"held-out gain: median {np.median(shares):.1%} of the oracle's, where that is above "
            f"nothing; {most} of {len(shares)} at least 95 %"
        )


def main(
    cases: str = "320", tasks: str = "arm,hopper,half_cheetah,walker2d", seed: str = "12"
) -> None:
    code = digest_of(*(f"adr_service/{name}" for name in METHOD))
    origin = {"tasks": tasks, "seed": int(seed), "code": code}
    names = tasks.split(",")
    jobs = [(number, names[number % len(names)], int(seed)) for number in range(int(cases))]

    def job_of(case: dict[str, Any]) -> tuple[int, str, int]:
        return case["number"], case["hidden"]["task"], int(seed)

    ended = all_cases(PATH, origin, jobs, one, job_of, _line)
    print(table(ended))
    print(f"failed: {sum('failed' in case for case in ended)} of {len(ended)}")


def _line(case: dict[str, Any]) -> str:
    """Text for one case as it ends."""
    hidden = case["hidden"]
    opening = f"{case['number']:4d} {hidden['task']:12s}"
    if "failed" in case:
        return f"{opening} failed: {case['failed']}"
    answer = case["answer"]
    first = answer["causes"][:1]
    named = [f"{c['kind']} {c['location']}" for c in first] or [answer["verdict"]]
    tied = len(answer["tied"][0]) if first else 0
    planted = [f"{e['kind']} {e['location']}" for e in hidden["effects"]]
    good = is_named(_marked(case)) if planted else ""
    return (
        f"{opening} {hidden['ratio']:4g} {'+'.join(planted) or hidden['outside'] or 'nothing':50s} "
        f"-> {named[0]} (+{tied}) {good} {answer['cpu_seconds']:.0f} s"
    )


if __name__ == "__main__":
    main(*sys.argv[1:])
