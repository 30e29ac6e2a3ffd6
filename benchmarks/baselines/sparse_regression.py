"""Sparse regression of everything that the simulator misses on a library of terms (PySINDy).

The free parameters are fitted first. What the simulator then misses in all sensors is regressed on
what each term would add as a force on each joint, or to each sensor (`terms.py`). Sequentially
thresholded least squares (Brunton, Proctor and Kutz, PNAS 113, 2016) keeps a few terms for each of
many thresholds. The fewest terms that explain 95 % of what the ones with the lowest BIC explain are
taken, and of these any whose loss costs less than 6 of BIC is dropped. A kept term is an effect if
it is the one that an effect at its place adds. Any other kept term is a force that nothing in the
catalogue explains. So the method does not see effects in bodies or the world as such.
"""

import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np
import pysindy

from adr_service.arrays import Matrix, Vector
from adr_service.blind_test.files import Answer, Estimate, Named, Question
from adr_service.criticism.verdict import Conclusion
from benchmarks.baselines.fitting import Fits, one_step, simulator_of
from benchmarks.baselines.terms import Regression, Term, regression_of

_THRESHOLDS = np.geomspace(1e-3, 1.0, 25)  # of coefficients; terms and errors have size one
_STRONG = 6.0  # of BIC; as among nested models
_MOST_OF = 0.95  # of what the best terms explain, that fewer have to
_KINDS = {  # symbol of a term of the joint's own -> effects, and their strength's name
    "q": (("joint_spring", "stiffness"),),
    "q³": (("joint_cubic_spring", "hardening"),),
    "v": (("joint_viscous_friction", "damping"),),
    "v > 0": (("joint_asymmetric_viscous_friction", "damping"),),
    "v|v|": (("joint_quadratic_friction", "drag"),),
    "sign v": (("joint_coulomb_friction", "friction"),),
    "a": (("joint_armature", "armature"),),
    "1": (("actuator_bias", "force"),),
    "u": (("actuator_gain", "relative change"),),
    "u before": (("actuator_delay", "delay"), ("actuator_lag", "time constant")),
    "sign u": (("actuator_deadband", "half width"),),
    "u|u|": (("actuator_saturation", "lost range"),),
    "u t": (("actuator_fade", "loss in an episode"),),
    "bias": (("sensor_bias", "bias"),),
    "scale": (("sensor_scale", "relative change"),),
    "rate": (("sensor_delay", "delay"),),
}
_UNKNOWN_SIZE = ("u|u|",)  # a stand-in, which does not say how much range is lost
_POSITIVE = ("sign v", "u before", "sign u", "rate")  # strengths


@dataclass(frozen=True)
class _Kept:
    """A term with its coefficient."""

    term: Term
    coefficient: float
    error: float  # standard
    size: float  # root mean square of what it adds, in deviations


def answer(question: Question, rng: np.random.Generator) -> Answer:
    """The effects whose terms are kept; draws nothing."""
    with simulator_of(question.nominal, question.measurement) as simulator:
        parameters = Fits(simulator, one_step).plain.parameters
        period = simulator.period
    regression = regression_of(question.nominal, question.measurement, parameters)
    model = question.nominal.model(parameters)
    return _answered(_kept(regression), model, period)


def _kept(regression: Regression) -> list[_Kept]:
    """The terms that the criterion keeps, the largest first."""
    columns, target = regression.columns, regression.target
    chosen = _chosen(columns, target / np.sqrt(np.mean(target**2)))
    if not chosen:
        return []
    design = columns[:, chosen]
    solved = np.linalg.lstsq(design, target, rcond=None)[0]
    variance = float(np.sum((target - design @ solved) ** 2)) / (len(target) - len(chosen))
    errors = np.sqrt(variance * np.diag(np.linalg.pinv(design.T @ design)))
    kept = [
        _Kept(
            regression.terms[number],
            float(solved[place] / regression.scales[number]),
            float(errors[place] / regression.scales[number]),
            abs(float(solved[place])),
        )
        for place, number in enumerate(chosen)
    ]
    return sorted(kept, key=lambda each: -each.size)


def _chosen(columns: Matrix, target: Vector) -> list[int]:
    """Numbers of the columns that the criterion keeps."""
    supports: set[tuple[int, ...]] = {()}
    for threshold in _THRESHOLDS:
        optimizer: Any = pysindy.STLSQ(threshold=threshold)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # that it keeps no term
            optimizer.fit(columns, target[:, None])
        supports.add(tuple(np.flatnonzero(optimizer.coef_[0]).tolist()))
    support = min(sorted(supports), key=lambda each: _bic(columns, target, each))
    whole = _squares(columns, target, ())
    enough = whole - _MOST_OF * (whole - _squares(columns, target, support))
    support = min(
        (each for each in sorted(supports) if _squares(columns, target, each) <= enough), key=len
    )
    while support:
        fewer = [tuple(n for n in support if n != left) for left in support]
        best = min(fewer, key=lambda each: _bic(columns, target, each))
        if _bic(columns, target, best) > _bic(columns, target, support) + _STRONG:
            break
        support = best
    return list(support)


def _bic(columns: Matrix, target: Vector, support: Sequence[int]) -> float:
    n = len(target)
    squares = _squares(columns, target, support)
    return n * float(np.log(squares / n)) + len(support) * float(np.log(n))


def _squares(columns: Matrix, target: Vector, support: Sequence[int]) -> float:
    """Sum of squares that these columns leave."""
    design = columns[:, list(support)]
    left = target - design @ np.linalg.lstsq(design, target, rcond=None)[0]
    return float(np.sum(left**2))


def _answered(kept: Sequence[_Kept], model: mujoco.MjModel, period: float) -> Answer:
    named = [_effects(each, model, period) for each in kept]
    if named and not named[0]:
        return Answer(verdict=Conclusion.UNKNOWN)
    groups = [group for group in named if group]
    return Answer.naming(groups, "none" if all(named) else "unknown")


def _effects(kept: _Kept, model: mujoco.MjModel, period: float) -> list[Named]:
    """The effects that a term is, which are tied; none: it is a force of another kind."""
    symbol, place = kept.term.symbol, kept.term.place
    if symbol in ("bias", "scale", "rate"):
        location, scale = f"sensor:{place}", -1.0 if symbol == "rate" else 1.0
    elif symbol == "1" or "u" in symbol:
        joint = model.joint(place).id
        drives = np.flatnonzero(model.actuator_trnid[:, 0] == joint).tolist()
        if not drives or kept.term.element not in ("", model.actuator(drives[0]).name):
            return []
        location = f"actuator:{model.actuator(drives[0]).name}"
        gear = float(model.actuator_gear[drives[0], 0])
        scale = {"1": 1.0, "u": 1 / gear, "u before": period / gear}.get(symbol, -1 / gear)
    elif kept.term.element == place:
        location, scale = f"joint:{place}", -1.0
    else:
        return []
    value, reach = scale * kept.coefficient, 1.96 * abs(scale) * kept.error
    if symbol in _POSITIVE and value < 0:
        return []
    estimate = Estimate(value=value, low=value - reach, high=value + reach)
    return [
        Named(
            kind=kind,
            location=location,
            parameters={} if symbol in _UNKNOWN_SIZE else {name: estimate},
        )
        for kind, name in _KINDS.get(symbol, ())
    ]
