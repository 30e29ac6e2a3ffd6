"""Makes a blind test, lets all methods answer it, and prints their scores side by side.

    python -m benchmarks.baselines.comparison [--cases 60] [--seed 31] [--task arm] [--examples N]

Everything is kept in build/bench/baselines, and goes on from there where it was interrupted, while
the methods are the same. As many processes at once as there are cores, each with one thread (set
OMP_NUM_THREADS=1).
"""

import argparse
import os
import sys
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path

import numpy as np

from adr_service.blind_test.answering import Method, answer_question, by_criticism
from adr_service.blind_test.files import (
    has_answer,
    make_cases,
    questions_in,
    read_answers,
    read_key,
)
from adr_service.blind_test.scoring import marked, score
from adr_service.errors import AdrError
from benchmarks.baselines import classifier, nested_models, sparse_regression
from benchmarks.ended_cases import digest_of

FOLDER = Path("build/bench/baselines")
METHODS: dict[str, Method] = {
    "criticism": by_criticism,
    "nested models": nested_models.answer,
    "sparse regression": sparse_regression.answer,
}
CLASSIFIER = "classifier"
Job = tuple[str, Path, Path]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--cases", type=int, default=60)
    parser.add_argument("--task", default="arm")
    parser.add_argument("--seed", type=int, default=31)
    parser.add_argument(
        "--examples", type=int, default=1500, help="that the classifier learns from"
    )
    given = parser.parse_args()
    code = digest_of("adr_service", "benchmarks/baselines")
    folder = FOLDER / f"{given.task}-{given.seed}-{given.cases}-{given.examples}-{code}"
    cases, key = folder / "cases", folder / "key.json"
    if not key.exists():
        make_cases(cases, key, [given.task], given.cases, given.seed)
    with ProcessPoolExecutor(len(os.sched_getaffinity(0)), mp_context=get_context("spawn")) as pool:
        for line in pool.map(answered, missing(folder, list(METHODS))):
            print(line, file=sys.stderr, flush=True)
        if left := list(missing(folder, [CLASSIFIER])):
            learned = classifier.trained(given.task, given.examples, given.seed + 1, pool)
            print(f"classifier: {learned.cpu_seconds:.0f} CPU s to learn", file=sys.stderr)
            for _, question, answer in left:
                print(_tried(CLASSIFIER, learned.answer, question, answer), file=sys.stderr)
    known = read_key(key)
    scores = {
        name: score(marked(known, read_answers(folder / name, known)))
        for name in [*METHODS, CLASSIFIER]
    }
    print(f"| | {' | '.join(scores)} |\n|{'---|' * (len(scores) + 1)}")
    for name in scores[CLASSIFIER]:
        print(f"| {name} | {' | '.join(column[name] for column in scores.values())} |")


def missing(folder: Path, methods: list[str]) -> Iterator[Job]:
    """The questions that a method has not answered, case by case."""
    for question in questions_in(folder / "cases"):
        for name in methods:
            answer = folder / name / question.name
            if not has_answer(answer):
                yield name, question, answer


def answered(job: Job) -> str:
    """Line for an answer, or for the error that ended it, which leaves the case unanswered."""
    name, question, answer = job
    return _tried(name, METHODS[name], question, answer)


def _tried(name: str, method: Method, question: Path, answer: Path) -> str:
    try:
        given = answer_question(method, question, answer, seed=0)
    except (AdrError, ArithmeticError, ValueError, np.linalg.LinAlgError) as error:
        return f"{question.name} {name}: {type(error).__name__}: {error}"
    named = [f"{cause.kind} {cause.location}" for cause in given.causes]
    return f"{question.name} {name}: {given.verdict.value} {', '.join(named)}"


if __name__ == "__main__":
    main()
