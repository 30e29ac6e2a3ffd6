"""The kinds of distributions by name, and how a document becomes one of them."""

from collections.abc import Callable
from typing import Any

from adr_service.distributions.base import Distribution
from adr_service.distributions.beta import Beta
from adr_service.distributions.empirical import Empirical
from adr_service.distributions.gaussian import Gaussian
from adr_service.distributions.mixture import Mixture
from adr_service.distributions.truncated_gaussian import TruncatedGaussian
from adr_service.distributions.uniform import Uniform
from adr_service.errors import InvalidInput, UnknownName
from adr_service.parameters import ParameterSpace

KINDS: dict[str, tuple[Callable[..., Distribution], tuple[str, ...]]] = {
    "uniform": (Uniform, ("low", "high")),
    "gaussian": (Gaussian, ("location", "covariance")),
    "truncated_gaussian": (TruncatedGaussian, ("mean", "std")),
    "beta": (Beta, ("alpha", "beta")),
    "mixture": (Mixture, ("weights", "locations", "covariances")),
    "empirical": (Empirical, ("points", "weights")),
}


def distribution_from_json(space: ParameterSpace, document: dict[str, Any]) -> Distribution:
    """The distribution of a document that `to_json` made."""
    kind = str(document.get("kind"))
    if kind not in KINDS:
        raise UnknownName("distribution kind", kind, KINDS)
    create, fields = KINDS[kind]
    if unknown := sorted(document.keys() - {"kind", *fields}):
        raise InvalidInput(f"a {kind} distribution has {', '.join(fields)}; given {unknown} too")
    if missing := [name for name in fields if name not in document]:
        raise InvalidInput(f"a {kind} distribution needs {', '.join(fields)}; not given: {missing}")
    return create(space, *(document[name] for name in fields))
