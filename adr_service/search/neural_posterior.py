"""Neural posterior estimation of points in [0, 1]^d, by sbi (Tejero-Cantero et al., 2020).

    posterior = FlowPosterior(d, epochs=50, rng=rng)
    posterior.learn(points, features, seen)            # (n, d) in [0, 1], (n, k), (k,)
    posterior.sample(100)                              # (100, d), given what was seen

A network learns q(point | features) from simulations of points. `learn` may be called again with
points that were sampled from it (sequential estimation). Random numbers come from a fork of
PyTorch's global generator, seeded from our stream.
"""

import logging
import math
import warnings
from collections.abc import Generator
from contextlib import contextmanager, redirect_stdout
from io import StringIO
from typing import Any

import numpy as np
import torch
from sbi.inference import NPE_C
from sbi.neural_nets import posterior_nn
from scipy.special import expit
from torch.distributions import (
    Independent,
    SigmoidTransform,
    TransformedDistribution,
    Uniform,
)

from adr_service.arrays import Array3, Matrix, Vector
from adr_service.search.seeding import on_one_thread, seeded

_HIDDEN = 50  # units of a hidden layer, sbi's
_ATOMS = 10  # simulations that a loss of later rounds compares, sbi's and NPDR's
_EDGE = 1e-7  # least distance of a sample from a bound
_HALF = np.sqrt(3.0)  # half width of a uniform distribution whose deviation is 1


class MixturePosterior:
    """A mixture density network: a mixture of Gaussians, whose parameters depend on features."""

    def __init__(self, d: int, components: int, epochs: int, rng: np.random.Generator):
        self._rng, self._most = rng, epochs
        ends = torch.full((d,), _HALF)
        prior = Independent(Uniform(-ends, ends), 1)  # of centred points
        build = posterior_nn(
            "mdn",
            z_score_theta="none",
            z_score_x="none",
            hidden_features=_HIDDEN,
            num_components=components,
        )
        with seeded(rng):
            self._trainer = NPE_C(prior, build, show_progress_bars=False, tracker=_Silent())

    def learn(self, points: Matrix, features: Matrix) -> None:
        centred = _HALF * (2 * points - 1)
        with seeded(self._rng), _warnings_of_ours():
            self._trainer.append_simulations(_tensor(centred), _tensor(features))
            self._estimator: Any = _trained(self._trainer, self._most)

    @property
    def epochs(self) -> list[int]:
        return _epochs(self._trainer)

    def mixture(self, seen: Vector) -> tuple[Vector, Matrix, Array3]:
        """Weights (c,), means (c, d) and covariances (c, d, d) of the mixture, given features."""
        with on_one_thread(), torch.no_grad():
            found = self._estimator.get_uncorrected_mog(_tensor(seen[None]))
            weights = torch.softmax(found.logits.double(), dim=1)[0]
            factors = torch.linalg.inv(found.precision_factors[0].double())  # of P = U^T U
        unit = 1 / (2 * _HALF)  # of a centred point, in [0, 1]
        scaled = unit * _array(factors)
        held = _array(weights) > 0  # others have underflown
        means = 0.5 + unit * _array(found.means[0])
        covariances = scaled @ scaled.swapaxes(1, 2)
        shares = _array(weights)[held]
        return shares / shares.sum(), means[held], covariances[held]


class FlowPosterior:
    """A masked autoregressive flow over logits of points, so that no sample leaves [0, 1]^d."""

    def __init__(self, d: int, epochs: int, rng: np.random.Generator):
        self._rng, self._most = rng, epochs
        # Zuko's: in nflows' ("maf") the first parameter of a transform never sees the features
        build = posterior_nn(
            "zuko_maf", z_score_x="none", hidden_features=_HIDDEN, num_transforms=5
        )
        prior = Independent(_Logistic(d), 1)
        with seeded(rng):
            self._trainer = NPE_C(prior, build, show_progress_bars=False, tracker=_Silent())
        self._posterior: Any = None
        self._least_atoms = _ATOMS

    def learn(self, points: Matrix, features: Matrix, seen: Vector) -> None:
        """Learn from points of the uniform prior, at first, then of `sample`."""
        proposal = self._posterior
        logits = _tensor(np.log(points) - np.log1p(-points))
        with seeded(self._rng), _warnings_of_ours():
            self._trainer.append_simulations(logits, _tensor(features), proposal=proposal)
            if proposal is None:
                estimator = _trained(self._trainer, self._most)
            else:
                estimator = _trained(
                    self._trainer, self._most, num_atoms=_ATOMS, use_combined_loss=True
                )
                self._least_atoms = min(self._least_atoms, len(self._trainer.val_indices))
            self._posterior = self._trainer.build_posterior(estimator)
            self._posterior.set_default_x(_tensor(seen[None]))

    @property
    def epochs(self) -> list[int]:
        return _epochs(self._trainer)

    @property
    def validation_atoms(self) -> int | None:
        """Atoms of the loss that ends a training, where too few simulations are held out for 10.

        The fewest of all rounds. Training itself always has 10.
        """
        return self._least_atoms if self._least_atoms < _ATOMS else None

    def sample(self, n: int) -> Matrix:
        """Points (n, d), given what was seen."""
        with seeded(self._rng), torch.no_grad():
            logits = self._posterior.sample((n,), show_progress_bars=False)
        # the prior has no density beyond these: float32's sigmoid is 0 or 1 there
        return np.clip(expit(_array(logits)), _EDGE, 1 - _EDGE)


class _Logistic(TransformedDistribution):
    """The distribution of the logits of uniform points."""

    def __init__(self, d: int):
        uniform = Uniform(torch.zeros(d), torch.ones(d))
        super().__init__(uniform, [SigmoidTransform().inv])
        self._d = d

    @property
    def mean(self) -> torch.Tensor:
        return torch.zeros(self._d)

    @property
    def variance(self) -> torch.Tensor:
        return torch.full((self._d,), math.pi**2 / 3)


def _epochs(trainer: NPE_C) -> list[int]:
    """Passes over the simulations of each training so far."""
    return list(trainer.summary["epochs_trained"])


def _trained(trainer: NPE_C, epochs: int, **options: Any) -> Any:
    """The trained network; sbi prints when it has converged."""
    with redirect_stdout(StringIO()):
        return trainer.train(max_num_epochs=epochs, **options)


@contextmanager
def _warnings_of_ours() -> Generator[None]:
    """Silence what we expect or report.

    Features have long tails, on a scale of quartiles. `epochs` says where a training ended, and
    `validation_atoms` that sbi took fewer atoms than it was given.
    """
    root = logging.getLogger()
    root.addFilter(_is_not_of_atoms)
    try:
        with warnings.catch_warnings():
            warnings.filterwarnings("ignore", "Data has extreme outliers")
            warnings.filterwarnings("ignore", "Maximum number of epochs")
            yield
    finally:
        root.removeFilter(_is_not_of_atoms)


def _is_not_of_atoms(record: logging.LogRecord) -> bool:
    return not record.getMessage().startswith("num_atoms=")


class _Silent:
    """A tracker that writes nothing: sbi's own makes a folder per training."""

    log_dir = None

    def log_metric(self, name: str, value: float, step: int | None = None) -> None: ...
    def log_metrics(self, metrics: dict[str, float], step: int | None = None) -> None: ...
    def log_params(self, params: dict[str, Any]) -> None: ...
    def add_figure(self, name: str, figure: Any, step: int | None = None) -> None: ...
    def flush(self) -> None: ...


def _tensor(values: Any) -> torch.Tensor:
    return torch.tensor(np.asarray(values), dtype=torch.float32)


def _array(tensor: torch.Tensor) -> Any:
    return tensor.numpy().astype(np.float64)
