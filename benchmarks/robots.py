"""Criticisms of real robots; docs/real-robots.md has the list, and what is known of each.

    python -m benchmarks.robots [name …]

Reads the recordings in ADR_DATASETS (docs/datasets.md), prints a line for each robot, and writes
the report of each to build/bench/robots.
"""

import sys
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

from adr_service.criticism.measurements import Measurement
from adr_service.criticism.nominal import Nominal
from adr_service.criticism.pipeline import criticise
from adr_service.criticism.report import files_of
from adr_service.criticism.verdict import NamedCause, Verdict
from adr_service.errors import UnknownName
from benchmarks import sources
from benchmarks.sources import feetech, pendulums
from benchmarks.sources.pendulums import COMMANDED, PLAIN, PLAIN_SHORT, SINGLE, Format, Link

FOLDER = Path("build/bench/robots")
COLUMNS = ("robot", "verdict", "causes, with what is tied", "of the held-out error gone", "CPU s")
Robot = Callable[[Path], tuple[Nominal, Measurement]]


def _pendulum(links: tuple[Link, ...], columns: Format, *files: str) -> Robot:
    return lambda data: (
        pendulums.nominal(links),
        pendulums.read([data / file for file in files], links, columns),
    )


def _double(pattern: str, names: str) -> list[str]:
    return [f"dfki_double_pendulum/{pattern.format(name)}" for name in names.split()]


_AUGUST = "design_A.0/20220812/{}/20220812-{}-PM_measured.csv"
_JUNE = "design_C.1/sys_id/20230629/20230629-{}/trajectory.csv"
_TIMES = "143339 143524 143601 143704 143747 143906 144003 144115"
ROBOTS: dict[str, Robot] = {
    "double-a": _pendulum(
        pendulums.A,
        COMMANDED,
        *_double("design_A.0/20220815/sys_id/trajectory_{}.csv", "00 01 02 03 12 13"),
    ),
    "double-a-off": _pendulum(
        pendulums.A,
        PLAIN,
        *_double(_AUGUST.replace("{}", "sys_id", 1), "055032 055640 055903"),
    ),
    "double-a-on": _pendulum(
        pendulums.A,
        PLAIN_SHORT,
        *_double(_AUGUST.replace("{}", "sys_id_friccomp", 1), "063536"),
    ),
    "double-c": _pendulum(pendulums.C, COMMANDED, *_double(_JUNE, _TIMES)),
    "pendulum": _pendulum(pendulums.ONE, SINGLE, "dfki_simple_pendulum/data_measured.csv"),
    "pendulum-1kg": _pendulum(pendulums.ONE, SINGLE, "dfki_simple_pendulum/data_measured_1kg.csv"),
    "servo": lambda data: (
        feetech.nominal(),
        feetech.read(sorted((data / "bam_feetech").glob("*.json"))),
    ),
}


def main(names: list[str]) -> None:
    if others := [name for name in names if name not in ROBOTS]:
        raise UnknownName("robot", others[0], ROBOTS)
    data = sources.folder()
    print(f"| {' | '.join(COLUMNS)} |\n|{'---|' * len(COLUMNS)}")
    for name in names or ROBOTS:
        started = time.process_time()
        criticism = criticise(*ROBOTS[name](data), np.random.default_rng(0), threads=1)
        seconds = time.process_time() - started
        folder = FOLDER / name
        folder.mkdir(parents=True, exist_ok=True)
        for file, content in files_of(criticism, name, name).items():
            (folder / file).write_bytes(content)
        print(f"| `{name}` | {' | '.join(_cells(criticism.verdict))} | {seconds:.0f} |", flush=True)


def _cells(verdict: Verdict) -> tuple[str, str, str]:
    causes = [
        " or ".join([_words(cause), *(f"{each.kind} {each.location}" for each in tied)])
        for cause, tied in zip(verdict.causes, verdict.tied, strict=True)
    ]
    rest = "" if verdict.residual.rest == "none" else f"; left: {verdict.residual.where.words}"
    gain = ""
    if (given := verdict.gain) is not None:
        low, most, high = (f"{100 * v:.0f}" for v in (given.low, given.sse_removed, given.high))
        gain = f"{most} % [{low}, {high}]"
    return verdict.conclusion.value + rest, "; ".join(causes), gain


def _words(cause: NamedCause) -> str:
    strengths = ", ".join(
        f"{each.value:.3g} {each.unit} [{each.interval}]" for each in cause.strengths
    )
    return f"{cause.kind} {cause.location} {strengths}"


if __name__ == "__main__":
    main(sys.argv[1:])
