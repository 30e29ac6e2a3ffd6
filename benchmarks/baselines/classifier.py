"""A classifier of residuals, trained on simulated cases (scikit-learn).

What the simulator misses in all sensors is regressed on terms of positions, velocities,
accelerations, commands and readings (`terms.py`). The t values of the terms, each alone and all
together, with the size of the errors and their correlation from row to row, are the features. A
forest of extremely randomised trees (Geurts, Ernst and Wehenkel, Machine Learning 63, 2006) learns
from cases of other seeds which effect was hidden, if any. It answers nothing, something unknown or
one effect, whichever is likeliest. Of effects it names the likeliest, and up to two others that are
at least half as likely are tied. It estimates no strengths.
"""

import time
from collections.abc import Sequence
from concurrent.futures import Executor
from dataclasses import dataclass
from typing import Any

import numpy as np
from sklearn.ensemble import ExtraTreesClassifier

from adr_service.arrays import Vector
from adr_service.blind_test.cases import Hidden, draw_blind
from adr_service.blind_test.files import Answer, Named, Question
from adr_service.criticism.measurements import Measurement
from adr_service.criticism.nominal import Nominal
from adr_service.criticism.verdict import Conclusion
from benchmarks.baselines.terms import regression_of

_NOTHING, _OUTSIDE = "nothing", "outside"
_TREES = 500
_AS_LIKELY = 0.5  # times the likeliest
_MOST = 3  # effects named and tied


@dataclass(frozen=True)
class Example:
    """A case to learn from."""

    features: Vector
    label: str
    cpu_seconds: float  # to simulate it


class Classifier:
    """A forest for one task."""

    def __init__(self, examples: Sequence[Example], seed: int):
        started = time.process_time()
        self._forest: Any = ExtraTreesClassifier(_TREES, random_state=seed, n_jobs=1)
        self._forest.fit(
            np.stack([each.features for each in examples]), [each.label for each in examples]
        )
        self.cpu_seconds = time.process_time() - started + sum(e.cpu_seconds for e in examples)

    def answer(self, question: Question, rng: np.random.Generator) -> Answer:
        """The likeliest label as an answer; draws nothing."""
        seen = features_of(question.nominal, question.measurement)
        chances = self._forest.predict_proba(seen[None])[0]
        known = dict(zip(map(str, self._forest.classes_), chances.tolist(), strict=True))
        nothing, outside = known.pop(_NOTHING, 0.0), known.pop(_OUTSIDE, 0.0)
        largest = max(nothing, outside, sum(known.values()))
        if largest == nothing:
            return Answer(verdict=Conclusion.NONE)
        if largest == outside:
            return Answer(verdict=Conclusion.UNKNOWN)
        ranked = sorted(known, key=lambda label: -known[label])
        likely = [n for n in ranked[:_MOST] if known[n] >= _AS_LIKELY * known[ranked[0]]]
        return Answer.naming([[_named(label) for label in likely]], "none")


def trained(task: str, cases: int, seed: int, pool: Executor) -> Classifier:
    """A classifier that has learned from cases of a seed that no test has."""
    jobs = [(task, seed, number) for number in range(cases)]
    return Classifier(list(pool.map(example, jobs, chunksize=10)), seed)


def example(job: tuple[str, int, int]) -> Example:
    """One simulated case of a task, by a seed and a number."""
    task, seed, number = job
    started = time.process_time()
    hidden, case = draw_blind(task, np.random.default_rng([seed, number]))
    features = features_of(case.nominal, case.measurement)
    return Example(features, _label(hidden), time.process_time() - started)


def _label(hidden: Hidden) -> str:
    if hidden.outside is not None:
        return _OUTSIDE
    if not hidden.effects:
        return _NOTHING
    return f"{hidden.effects[0].kind} {hidden.effects[0].location}"  # of two the first


def _named(label: str) -> Named:
    kind, _, location = label.partition(" ")
    return Named(kind=kind, location=location)


def features_of(nominal: Nominal, measurement: Measurement) -> Vector:
    """Sizes and correlations of the errors of each sensor, and t values of all terms."""
    regression = regression_of(nominal, measurement, nominal.start)
    columns, target, errors = regression.columns, regression.target, regression.errors
    deviation = float(np.std(target))
    alone = columns.T @ target / (deviation * np.linalg.norm(columns, axis=0))
    solved = np.linalg.lstsq(columns, target, rcond=None)[0]
    spread = np.sqrt(np.diag(np.linalg.pinv(columns.T @ columns)))
    persistence = np.mean(errors[:-1] * errors[1:], axis=0) / np.mean(errors**2, axis=0)
    together = solved / (deviation * spread)
    return np.concatenate([np.log(regression.deviations), persistence, alone, together])
