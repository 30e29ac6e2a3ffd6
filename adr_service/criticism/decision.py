"""The rule that turns evidence into names: one cause, several alike, none, or none that we know.

A gain counts from `THRESHOLD` nats (a study of single-step residuals on Hopper had 21 at most in
26 cases without any cause), and only where it is more than two standard errors by what episodes
differ, or as much without the two that gain most: touches of the ground that no simulator foresees
gain 35 to 40 nats in one or two, true causes something in nearly all. Two causes differ by
more than `TIE` nats, `ALIKE` of what they explain and two standard errors of their difference.
Where a flexible force still explains more than a fifth of what the causes do, they are not what is
wrong.
"""

from dataclasses import dataclass

import numpy as np

from adr_service.arrays import Matrix, Vector

THRESHOLD = 25.0  # nats
TIE = 4.0  # nats
ALIKE = 0.01  # of a gain: what the simulator's finite step may change of it
_FEW = 2  # episodes, on which no evidence may hang
UNEXPLAINED = 0.2  # of what causes explain: what a flexible force may still add to them
_DRAWS = 1000


@dataclass(frozen=True)
class Decision:
    """Candidates that the evidence names, with their probabilities."""

    alike: tuple[int, ...]  # the best candidate and all that explain as much; empty: none
    # (candidates + 1,) probability of each, zero without evidence, and at last of none of them
    confidence: Vector


def decide(gains: Matrix, rng: np.random.Generator) -> Decision:
    """The best of candidates (c, E) in nats by episode, and all that explain as much."""
    totals = gains.sum(axis=1)
    order = [i for i in np.argsort(-totals).tolist() if is_evidence(gains[i])]
    confidence = np.zeros(len(gains) + 1)
    confidence[[*order, -1]] = _confidence(gains[order], rng)
    if not order:
        return Decision((), confidence)
    best = order[0]
    alike = [i for i in order if not beats(gains[best] - gains[i], totals[best])]
    return Decision(tuple(alike), confidence)


def is_unknown(flexible: Vector, named: float) -> bool:
    """True if a flexible force (E,) is evidence beside causes that explain `named` nats."""
    return is_evidence(flexible) and float(flexible.sum()) > UNEXPLAINED * named


def is_evidence(gains: Vector) -> bool:
    """True if gains by episode (E,) are more than chance, and do not hang on few episodes."""
    rest = np.sort(gains)[:-_FEW].sum()
    return bool(gains.sum() > THRESHOLD and (gains.sum() > _chance(gains) or rest > THRESHOLD))


def least_evident(information: Vector) -> float:
    """The smallest strength that `is_evidence`, where a strength s gains s^2 / 2 times the
    `information` (E,) in each episode; inf if there is none."""
    total = information.sum()
    if total <= _chance(information):
        total = np.sort(information)[:-_FEW].sum()
    return float(np.sqrt(2 * THRESHOLD / total)) if total > 0 else np.inf


def beats(difference: Vector, gain: float) -> bool:
    """True if a cause with a total `gain` explains more than another, by a `difference` (E,) that
    is beyond chance and the errors of either's simulation."""
    return bool(difference.sum() > max(TIE, _chance(difference), ALIKE * gain))


def _chance(gains: Vector) -> float:
    """Two standard errors of the sum of gains (E,)."""
    return 2 * float(np.sqrt(len(gains)) * gains.std(ddof=1))


def _confidence(gains: Matrix, rng: np.random.Generator) -> Vector:
    """Pseudo-BMA+: softmax of the gains under Bayesian bootstraps of the episodes (Yao et al.,
    2018). The last column, for none of them, has the gain that chance can reach."""
    episodes = gains.shape[1]
    weights = episodes * rng.dirichlet(np.ones(episodes), _DRAWS)
    totals = np.concatenate([weights @ gains.T, np.full((_DRAWS, 1), THRESHOLD)], axis=1)
    likely = np.exp(totals - totals.max(axis=1, keepdims=True))
    return np.mean(likely / likely.sum(axis=1, keepdims=True), axis=0)
