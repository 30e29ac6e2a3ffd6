"""Distributions over a parameter space: methods infer them, policies are trained on them.

    belief = Gaussian.prior(space)              # the paper's N(2, I) in [0, 4]
    draws = belief.sample(12, rng)       # .values (12, d) in SI units, .adjusted

Draws are always feasible. `Draws.adjusted` counts those that were moved to make them so.
"""

from adr_service.distributions.base import Distribution, Draws, check_space, normalised_std
from adr_service.distributions.beta import Beta
from adr_service.distributions.empirical import Empirical
from adr_service.distributions.gaussian import Gaussian
from adr_service.distributions.kinds import KINDS, distribution_from_json
from adr_service.distributions.mixture import Mixture
from adr_service.distributions.truncated_gaussian import TruncatedGaussian
from adr_service.distributions.uniform import Uniform, at_resolution

__all__ = [
    "KINDS",
    "Beta",
    "Distribution",
    "Draws",
    "Empirical",
    "Gaussian",
    "Mixture",
    "TruncatedGaussian",
    "Uniform",
    "at_resolution",
    "check_space",
    "distribution_from_json",
    "normalised_std",
]
