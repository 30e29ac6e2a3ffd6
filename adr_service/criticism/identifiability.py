"""Strengths that a recording cannot tell apart, whichever of them the robot has.

    for names in indistinguishable(baseline, responses, candidates):
        print(" or ".join(names))

The data determine only what these do together, as the base parameters of a robot's dynamics
(Gautier and Khalil, 1990), beside the free parameters that are fitted with them.
"""

from collections.abc import Sequence

import numpy as np
from scipy.cluster.hierarchy import fcluster, linkage
from scipy.spatial.distance import squareform

from adr_service.arrays import Matrix
from adr_service.criticism.decision import ALIKE
from adr_service.criticism.fits import Fit
from adr_service.criticism.linear import Normal
from adr_service.criticism.responses import Responses
from adr_service.criticism.scan import Candidate, Scan
from adr_service.effects.base import Effect
from adr_service.effects.catalogue import get_mechanism, is_part

_ABSORBED = 0.01  # of the information on a strength, which fitted parameters leave at least


def indistinguishable(
    fit: Fit, responses: Responses, candidates: Sequence[Candidate]
) -> tuple[tuple[str, ...], ...]:
    """Groups of strengths, as "kind location strength". Each does 99 % of what any other of its
    group does, at the sizes that a scan tried.

    `candidates`: of the scan. Left out are groups of places, what could be no evidence, and what
    the fitted parameters can do as well.
    """
    single = [candidate for candidate in candidates if len(candidate.tried) == 1]
    asked = [each.tried[0] for each in single if np.isfinite(each.limits).any()]
    look = Scan(fit, responses, asked)
    named = [
        (effect, number, column)
        for effect, columns in look.columns.items()
        for number, column in enumerate(columns)
    ]
    apart = _unlikeness(look.normal, look.own, [column for _, _, column in named])
    seen = np.flatnonzero(np.isfinite(np.diagonal(apart)))
    if len(seen) < 2:
        return ()
    distances = squareform(apart[np.ix_(seen, seen)], checks=False)
    labels = fcluster(linkage(distances, "complete"), ALIKE, "distance")
    groups = ([named[i][:2] for i in seen[labels == label].tolist()] for label in np.unique(labels))
    texts = (_names(group) for group in groups)
    return tuple(names for names in texts if len(names) > 1)


def _unlikeness(normal: Normal, own: Sequence[int], asked: Sequence[int]) -> Matrix:
    """(k, k) share of what one column does that another cannot do, beside a fit's own columns;
    infinite on the diagonal for columns that the fit's own can replace."""
    information = normal.information.sum(axis=0)
    whole = information[np.ix_(asked, asked)]
    left = whole - information[np.ix_(asked, own)] @ normal.absorbed(own, asked)
    is_seen = np.diagonal(left) > _ABSORBED * np.diagonal(whole)
    scale = np.sqrt(np.where(is_seen, np.diagonal(left), 1.0))
    apart = np.clip(1 - (left / np.outer(scale, scale)) ** 2, 0.0, 1.0)
    apart = (apart + apart.T) / 2
    np.fill_diagonal(apart, np.where(is_seen, 0.0, np.inf))
    return apart


def _names(strengths: Sequence[tuple[Effect, int]]) -> tuple[str, ...]:
    """Names of a group's strengths, without a mechanism that includes one of the others."""
    names: list[str] = []
    for effect, number in strengths:
        mechanism = get_mechanism(effect.kind)
        if any(is_part(other, effect) for other, _ in strengths):
            continue
        several = len(mechanism.strengths) > 1
        name = f"{effect.kind} {effect.location}"
        names.append(f"{name} {mechanism.strengths[number].name}" if several else name)
    return tuple(sorted(names))
