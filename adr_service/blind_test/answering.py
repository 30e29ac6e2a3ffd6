"""Answers to the questions of a blind test, by criticism or any other method."""

import json
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

from adr_service.blind_test.files import Answer, Question, read_question, write_answer
from adr_service.criticism.pipeline import criticise

Method = Callable[[Question, np.random.Generator], Answer]


def by_criticism(question: Question, rng: np.random.Generator) -> Answer:
    """The verdict of `adr criticise`."""
    verdict = criticise(question.nominal, question.measurement, rng, threads=1).verdict
    return Answer.model_validate_json(json.dumps(verdict.to_json()))


def answer_question(method: Method, question: Path, answer: Path, seed: int) -> Answer:
    """Answer one question, and write the answer with the CPU seconds that it took."""
    asked = read_question(question)
    started = time.process_time()
    given = method(asked, np.random.default_rng(seed))
    timed = given.model_copy(update={"cpu_seconds": time.process_time() - started})
    write_answer(answer, timed)
    return timed
