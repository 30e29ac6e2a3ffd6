"""Nested models: MuJoCo's system identification with one more effect at a time, chosen by BIC.

Whole episodes are simulated from their first rows on, and compared with all sensors by least
squares (`mujoco.sysid`). Candidates are ranked by one Gauss-Newton step, and the best fitted. The
one with the lowest Bayesian information criterion joins the model where it lowers that by more than
6, "strong evidence" (Kass and Raftery, JASA 90, 1995). Others within 6 of it are tied. The method
cannot answer `unknown`.
"""

import numpy as np

from adr_service.blind_test.files import Answer, Estimate, Named, Question
from adr_service.effects.base import Effect
from adr_service.effects.catalogue import get_mechanism
from benchmarks.baselines.fitting import Fits, Fitted, simulator_of, whole_episodes

STRONG = 6.0  # of BIC
_FITTED = 5  # candidates
_MOST = 3  # effects


def answer(question: Question, rng: np.random.Generator) -> Answer:
    """The effects that the criterion admits; draws nothing."""
    candidates = [e for e in question.candidates if not get_mechanism(e.kind).only_spreads]
    with simulator_of(question.nominal, question.measurement) as simulator:
        fits = Fits(simulator, whole_episodes)
        known, tied = fits.plain, list[list[Named]]()
        while len(known.effects) < _MOST:
            admitted = _next(fits, known, candidates)
            if not admitted:
                break
            known = admitted[0]
            tied.append([_named(each, -1) for each in admitted[1:]])
    return Answer.naming([[_named(known, n), *others] for n, others in enumerate(tied)], "none")


def _next(fits: Fits, known: Fitted, candidates: list[Effect]) -> list[Fitted]:
    """The best model with one more effect, and those as good as it; empty: none is admitted."""
    taken = {(effect.kind, effect.location) for effect in known.effects}
    left = [e for e in candidates if (e.kind, e.location) not in taken]
    steps = sorted((fits.step(known, effect) for effect in left), key=lambda step: -step.fall)
    fitted = [
        fits.fit([*known.effects, step.effect], known.parameters)
        for step in steps[:_FITTED]
        if np.isfinite(step.fall)
    ]
    models = [model for model in fitted if model is not None]
    models.sort(key=lambda model: model.bic())
    if not models or models[0].bic() > known.bic() - STRONG:
        return []
    return [model for model in models if model.bic() < models[0].bic() + STRONG]


def _named(model: Fitted, number: int) -> Named:
    """An effect of the model with its interval."""
    effect = model.effects[number]
    first = sum(len(e.values) for e in model.effects[: number % len(model.effects)])
    estimates: dict[str, Estimate] = {}
    for place, strength in enumerate(get_mechanism(effect.kind).strengths):
        value, reach = effect.values[place], float(model.reach[first + place])
        is_known = np.isfinite(reach)
        estimates[strength.name] = Estimate(
            value=value,
            low=value - reach if is_known else None,
            high=value + reach if is_known else None,
        )
    return Named(kind=effect.kind, location=effect.location, parameters=estimates)
