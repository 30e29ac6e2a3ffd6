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
from collections.abc import Callable, Sequence
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
    """A case, diagnosed; what was hidden and what was found, or why nothing was."""
    try:
        return _diagnosed(*job)
    except (AdrError, np.linalg.LinAlgError) as error:  # the others go on; the table counts it
        return {"number": job[0], "task": job[1], "failed": f"{type(error).__name__}: {error}"}


def _diagnosed(number: int, name: str, seed: int) -> dict[str, Any]:
    rng = np.random.default_rng([seed, number])
    task = get_task(name)
    nominal = Nominal.of_task(task, source_of(name, "vanilla"))
    kind = rng.choice(["none", "outside", "two", "one"], p=[0.20, 0.15, 0.05, 0.60])
    ratio = float(rng.choice(RATIOS)) if kind != "none" else 0.0
    case: Case | None = None
    while case is None:
        try:
            count = {"one": 1, "two": 2}.get(kind, 0)
            case = draw_case(task, nominal, rng, ratio, count, kind == "outside")
        except AdrError:
            continue
    started = time.process_time()
    found = criticise(case.nominal, case.measurement, rng, threads=1)
    seconds = time.process_time() - started
    verdict = found.verdict.to_json()
    gain = found.verdict.gain
    oracle = None if gain is None else _oracle(case, found)
    detectable = verdict["residual"].pop("detectable")
    return {
        "number": number,
        "task": name,
        "hidden": kind,
        "ratio": ratio,
        "causes": [[c.kind, c.location, c.values] for c in case.effects],
        "outside": case.outside,
        "verdict": verdict,
        "detectable": [detectable.get(f"{c.kind} {c.location}") for c in case.effects],
        "ranking": [[c.kind, c.location, c.gain] for c in found.candidates[:6]],
        "oracle": None if oracle is None else oracle.to_json(),
        "seconds": seconds,
    }


def _oracle(case: Case, found: Criticism) -> Gain:
    """Gain of the true parameters and effects on the same episodes."""
    truth = replace(found.final, parameters=case.truth, effects=case.effects)
    rng = np.random.default_rng(0)  # of intervals, which are not used
    return measure_gain(found.baseline, truth, split(case.measurement)[1], rng, threads=1)


def is_named(case: dict[str, Any], most_tied: int = _MOST_TIED) -> bool:
    """True if causes are named and each is hidden there, or tied with a hidden one."""
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
                found = next(iter(first["parameters"].values()))
                errors.append(abs(found["value"] / values[0] - 1))
                low, high = found["low"], found["high"]  # None: unbounded
                is_low = low is None or low <= values[0]
                covered.append(is_low and (high is None or values[0] <= high))
    return errors, covered


def table(cases: Sequence[dict[str, Any]]) -> str:
    lines: list[str] = []
    singles = [c for c in cases if c["hidden"] == "one"]
    for ratio in RATIOS:
        chosen = [c for c in singles if c["ratio"] == ratio]
        lines.append(f"one cause, ratio {ratio:g}: named {share(chosen, is_named)}")
        among = [c for c in chosen if is_named(c, most_tied=99)]
        lines.append(f"    in a tie of any size: {len(among)}")
    nulls = [c for c in cases if c["hidden"] == "none"]
    lines.append(f"nothing hidden: false alarms {share(nulls, is_alarm)}")
    for ratio in RATIOS:
        chosen = [c for c in cases if c["hidden"] == "outside" and c["ratio"] == ratio]
        lines.append(f"outside, ratio {ratio:g}: called unknown {share(chosen, is_unknown)}")
    known = [c for c in cases if c["hidden"] in ("one", "two", "none")]
    lines.append(f"false unknown: {share(known, is_unknown)}")
    pairs = [c for c in cases if c["hidden"] == "two"]
    lines.append(f"two causes: all that was named is true {share(pairs, is_named)}")
    right = [c for c in singles if is_named(c)]
    errors, covered = errors_of(right)
    if errors:
        lines.append(
            f"strength: median relative error {np.median(errors):.1%}; 95 % intervals cover "
            f"{np.mean(covered):.0%} of {len(covered)}"
        )
    seen = [c for c in right if c["oracle"] is not None and c["oracle"]["low"] > 0]
    if shares := [c["verdict"]["gain"]["sse_removed"] / c["oracle"]["sse_removed"] for c in seen]:
        most = sum(s >= 0.95 for s in shares)
        lines.append(
            f"held-out gain: median {np.median(shares):.1%} of the oracle's, where that is above "
            f"nothing; {most} of {len(shares)} at least 95 %"
        )
    lines.append(f"CPU seconds per case: median {np.median([c['seconds'] for c in cases]):.1f}")
    return "\n".join(lines)


def main(
    cases: str = "320", tasks: str = "arm,hopper,half_cheetah,walker2d", seed: str = "12"
) -> None:
    names = tasks.split(",")
    path, of = FOLDER / "criticism.json", {"tasks": tasks, "seed": int(seed), "code": _code()}
    known = json.loads(path.read_text()) if path.exists() else {}
    if known and {name: known.get(name) for name in of} != of:
        path.rename(path.with_name(f"criticism-{known.get('seed')}-{known.get('code')}.json"))
        known = {}
    found: list[dict[str, Any]] = [c for c in known.get("cases", []) if c["number"] < int(cases)]
    done = {case["number"] for case in found}
    jobs = [
        (number, names[number % len(names)], int(seed))
        for number in range(int(cases))
        if number not in done
    ]
    FOLDER.mkdir(parents=True, exist_ok=True)
    with ProcessPoolExecutor(len(os.sched_getaffinity(0))) as pool:
        for case in pool.map(one, jobs):
            found.append(case)
            whole = path.with_suffix(".part")
            whole.write_text(json.dumps({**of, "cases": found}, indent=1))
            whole.replace(path)
            if "failed" in case:
                print(
                    f"{case['number']:4d} {case['task']:12s} failed: {case['failed']}", flush=True
                )
                continue
            first = case["verdict"]["causes"][:1]
            said = [f"{c['kind']} {c['location']}" for c in first] or [case["verdict"]["verdict"]]
            tied = len(case["verdict"]["tied"][0]) if first else 0
            hidden = [f"{k} {p}" for k, p, _ in case["causes"]] or [case["outside"] or "nothing"]
            good = is_named(case) if case["causes"] else ""
            print(
                f"{case['number']:4d} {case['task']:12s} {case['ratio']:4g} {'+'.join(hidden):50s} "
                f"-> {said[0]} (+{tied}) {good} {case['seconds']:.0f} s",
                flush=True,
            )
    print(table([case for case in found if "failed" not in case]))
    print(f"failed: {sum('failed' in case for case in found)} of {len(found)}")


def _code() -> str:
    """Digest of the sources of criticism, which stands for its present version."""
    root = Path(adr_service.__file__).parent
    folders = ("criticism", "effects", "simulation")
    files = [file for folder in folders for file in (root / folder).rglob("*.py")]
    return sha256(b"".join(file.read_bytes() for file in sorted(files)))[:12]


if __name__ == "__main__":
    main(*sys.argv[1:])
