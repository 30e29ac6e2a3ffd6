"""Blind test of criticism: effects hidden in measurements, and whether they are named.

    python -m benchmarks.criticism [cases, 320] [tasks, arm,hopper,half_cheetah,walker2d] [seed, 12]

Of the cases 20 % hide nothing, 15 % an effect outside the catalogue, 5 % two effects, the rest one,
at effect-to-noise ratios .03, .1, .3 and 1. Every measurement has 30 episodes of 75 control steps.
As many processes at once as there are cores, each with one thread (set OMP_NUM_THREADS=1). Writes
build/bench/criticism.json after every case, and goes on from there where it was interrupted, while
the method is the same.
"""

import json
import os
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from scipy import stats

import adr_service
from adr_service.criticism.gain import measure_gain
from adr_service.criticism.nominal import Nominal
from adr_service.criticism.pipeline import Criticism, criticise, split
from adr_service.criticism.verdict import Gain
from adr_service.errors import AdrError
from adr_service.json_values import sha256
from adr_service.tasks.catalogue import get_task, source_of
from benchmarks.planted import Case, draw_case

FOLDER = Path("build/bench")
RATIOS = (0.03, 0.1, 0.3, 1.0)
_MOST_TIED = 3


def one(job: tuple[int, str, int]) -> dict[str, Any]:
    """One case with what was hidden and what criticism named, or with the error that ended it."""
    try:
        return _diagnosed(*job)
    except (AdrError, np.linalg.LinAlgError) as error:  # the others go on; the table counts it
        return {"number": job[0], "task": job[1], "failed": f"{type(error).__name__}: {error}"}


def _diagnosed(number: int, name: str, seed: int) -> dict[str, Any]:
    rng = np.random.default_rng([seed, number])
    kind = str(rng.choice(["none", "outside", "two", "one"], p=[0.20, 0.15, 0.05, 0.60]))
    ratio = float(rng.choice(RATIOS)) if kind != "none" else 0.0
    case = _drawn(name, kind, ratio, rng)
    started = time.process_time()
    criticism = criticise(case.nominal, case.measurement, rng, threads=1)
    seconds = time.process_time() - started
    return {
        "number": number,
        "task": name,
        "hidden": kind,
        "ratio": ratio,
        **_compared(case, criticism),
        "seconds": seconds,
    }


def _drawn(name: str, kind: str, ratio: float, rng: np.random.Generator) -> Case:
    """The first case that can be simulated."""
    task = get_task(name)
    nominal = Nominal.of_task(task, source_of(name, "vanilla"))
    count = {"one": 1, "two": 2}.get(kind, 0)
    while True:
        try:
            return draw_case(task, nominal, rng, ratio, count, kind == "outside")
        except AdrError:
            continue


def _compared(case: Case, criticism: Criticism) -> dict[str, Any]:
    """The hidden effects beside the verdict."""
    verdict = criticism.verdict.to_json()
    oracle = None if criticism.verdict.gain is None else _oracle(case, criticism)
    detectable = verdict["residual"].pop("detectable")
    return {
        "causes": [[c.kind, c.location, c.values] for c in case.effects],
        "outside": case.outside,
        "verdict": verdict,
        "detectable": [detectable.get(f"{c.kind} {c.location}") for c in case.effects],
        "ranking": [[c.kind, c.location, c.gain] for c in criticism.candidates[:6]],
        "oracle": None if oracle is None else oracle.to_json(),
    }


def _oracle(case: Case, criticism: Criticism) -> Gain:
    """Gain of the true parameters and effects on the same episodes."""
    truth = replace(criticism.final, parameters=case.truth, effects=case.effects)
    rng = np.random.default_rng(0)  # of intervals, which are not used
    return measure_gain(criticism.baseline, truth, split(case.measurement)[1], rng, threads=1)


def is_named(case: dict[str, Any], most_tied: int = _MOST_TIED) -> bool:
    """True if criticism named something, and each name or one tied with it is hidden there."""
    verdict = case["verdict"]
    if not verdict["causes"]:
        return False
    hidden = [tuple(c[:2]) for c in case["causes"]]
    for cause, tied in zip(verdict["causes"], verdict["tied"], strict=True):
        group = [(c["kind"], c["location"]) for c in [cause, *tied]]
        if not set(hidden) & set(group) or len(group) > most_tied:
            return False
    return True


def is_alarm(case: dict[str, Any]) -> bool:
    return bool(case["verdict"]["verdict"] != "none")


def is_unknown(case: dict[str, Any]) -> bool:
    return bool(case["verdict"]["verdict"] == "unknown")


def share(cases: Sequence[dict[str, Any]], right: Callable[[dict[str, Any]], bool]) -> str:
    count = sum(map(right, cases))
    if not cases:
        return "no cases"
    interval = stats.binomtest(count, len(cases)).proportion_ci(0.95)
    reach = f"[{interval.low:.0%}, {interval.high:.0%}]"
    return f"{count} of {len(cases)} = {count / len(cases):.0%} {reach}"


def errors_of(cases: Sequence[dict[str, Any]]) -> tuple[list[float], list[bool]]:
    """Relative errors of the first strength, and whether its interval covers the truth."""
    errors, covered = [], []
    for case in cases:
        first = case["verdict"]["causes"][0]
        for kind, location, values in case["causes"]:
            if (first["kind"], first["location"]) == (kind, location):
                strength = next(iter(first["parameters"].values()))
                errors.append(abs(strength["value"] / values[0] - 1))
                low, high = strength["low"], strength["high"]  # None: unbounded
                is_low = low is None or low <= values[0]
                covered.append(is_low and (high is None or values[0] <= high))
    return errors, covered


def table(cases: Sequence[dict[str, Any]]) -> str:
    """Shares, errors and gains over all cases that ended."""
    singles = [c for c in cases if c["hidden"] == "one"]
    pairs = [c for c in cases if c["hidden"] == "two"]
    right = [c for c in singles if is_named(c)]
    lines = [
        *_detections(singles),
        *_alarms(cases),
        f"two causes: all that was named is true {share(pairs, is_named)}",
        *_strengths(right),
        *_gains(right),
        f"CPU seconds per case: median {np.median([c['seconds'] for c in cases]):.1f}",
    ]
    return "\n".join(lines)


def _detections(singles: Sequence[dict[str, Any]]) -> Iterator[str]:
    for ratio in RATIOS:
        chosen = [c for c in singles if c["ratio"] == ratio]
        yield f"one cause, ratio {ratio:g}: named {share(chosen, is_named)}"
        among = [c for c in chosen if is_named(c, most_tied=99)]
        yield f"    in a tie of any size: {len(among)}"


def _alarms(cases: Sequence[dict[str, Any]]) -> Iterator[str]:
    nulls = [c for c in cases if c["hidden"] == "none"]
    yield f"nothing hidden: false alarms {share(nulls, is_alarm)}"
    for ratio in RATIOS:
        chosen = [c for c in cases if c["hidden"] == "outside" and c["ratio"] == ratio]
        yield f"outside, ratio {ratio:g}: called unknown {share(chosen, is_unknown)}"
    known = [c for c in cases if c["hidden"] in ("one", "two", "none")]
    yield f"false unknown: {share(known, is_unknown)}"


def _strengths(right: Sequence[dict[str, Any]]) -> Iterator[str]:
    errors, covered = errors_of(right)
    if errors:
        yield (
            f"strength: median relative error {np.median(errors):.1%}; 95 % intervals cover "
            f"{np.mean(covered):.0%} of {len(covered)}"
        )


def _gains(right: Sequence[dict[str, Any]]) -> Iterator[str]:
    seen = [c for c in right if c["oracle"] is not None and c["oracle"]["low"] > 0]
    if shares := [c["verdict"]["gain"]["sse_removed"] / c["oracle"]["sse_removed"] for c in seen]:
        most = sum(s >= 0.95 for s in shares)
        yield (
            f"held-out gain: median {np.median(shares):.1%} of the oracle's, where that is above "
            f"nothing; {most} of {len(shares)} at least 95 %"
        )


def main(
    cases: str = "320", tasks: str = "arm,hopper,half_cheetah,walker2d", seed: str = "12"
) -> None:
    path, origin = FOLDER / "criticism.json", {"tasks": tasks, "seed": int(seed), "code": _code()}
    ended = [case for case in _resumed(path, origin) if case["number"] < int(cases)]
    done, names = {case["number"] for case in ended}, tasks.split(",")
    jobs = [
        (number, names[number % len(names)], int(seed))
        for number in range(int(cases))
        if number not in done
    ]
    FOLDER.mkdir(parents=True, exist_ok=True)
    with ProcessPoolExecutor(len(os.sched_getaffinity(0))) as pool:
        for case in pool.map(one, jobs):
            ended.append(case)
            whole = path.with_suffix(".part")
            whole.write_text(json.dumps({**origin, "cases": ended}, indent=1))
            whole.replace(path)
            print(_line(case), flush=True)
    print(table([case for case in ended if "failed" not in case]))
    print(f"failed: {sum('failed' in case for case in ended)} of {len(ended)}")


def _resumed(path: Path, origin: dict[str, Any]) -> list[dict[str, Any]]:
    """The cases of an interrupted run; those of another method or seed are set aside."""
    known = json.loads(path.read_text()) if path.exists() else {}
    if known and {name: known.get(name) for name in origin} != origin:
        path.rename(path.with_name(f"criticism-{known.get('seed')}-{known.get('code')}.json"))
        return []
    return known.get("cases", [])


def _line(case: dict[str, Any]) -> str:
    """Text for one case as it ends."""
    opening = f"{case['number']:4d} {case['task']:12s}"
    if "failed" in case:
        return f"{opening} failed: {case['failed']}"
    first = case["verdict"]["causes"][:1]
    named = [f"{c['kind']} {c['location']}" for c in first] or [case["verdict"]["verdict"]]
    tied = len(case["verdict"]["tied"][0]) if first else 0
    hidden = [f"{k} {p}" for k, p, _ in case["causes"]] or [case["outside"] or "nothing"]
    good = is_named(case) if case["causes"] else ""
    return (
        f"{opening} {case['ratio']:4g} {'+'.join(hidden):50s} "
        f"-> {named[0]} (+{tied}) {good} {case['seconds']:.0f} s"
    )


def _code() -> str:
    """Digest of the sources of the present method."""
    root = Path(adr_service.__file__).parent
    folders = ("criticism", "effects", "simulation")
    files = [file for folder in folders for file in (root / folder).rglob("*.py")]
    return sha256(b"".join(file.read_bytes() for file in sorted(files)))[:12]


if __name__ == "__main__":
    main(*sys.argv[1:])
