"""Bayesian optimisation in the unit cube, by BoTorch (Balandat et al., arXiv 1910.06403).

    surrogate = Surrogate(points, values, rng)      # (n, d) in [0, 1], (n,) larger is better
    surrogate.mean(points)                          # (n,)
    surrogate.propose()                             # (d,) the next point to evaluate

A Gaussian process with a Matern-5/2 kernel (Rasmussen and Williams 2006, eq. 4.17), one length
scale per coordinate, on standardised values. Its random numbers come from a fork of PyTorch's
global generator, seeded from our stream.
"""

import numpy as np
import torch
from botorch.acquisition import LogExpectedImprovement
from botorch.fit import fit_gpytorch_mll
from botorch.models import SingleTaskGP
from botorch.models.transforms import Standardize
from botorch.models.utils.gpytorch_modules import get_gaussian_likelihood_with_gamma_prior
from botorch.optim import optimize_acqf
from gpytorch.kernels import MaternKernel, ScaleKernel
from gpytorch.mlls import ExactMarginalLogLikelihood
from gpytorch.priors import GammaPrior

from adr_service.arrays import Matrix, Vector
from adr_service.search.seeding import on_one_thread, seeded

_RESTARTS, _RAW = 20, 512  # of the search for the largest expected improvement


class Surrogate:
    def __init__(self, points: Matrix, values: Vector, rng: np.random.Generator):
        self._rng, self._d = rng, points.shape[1]
        x = torch.tensor(points, dtype=torch.float64)
        y = torch.tensor(values, dtype=torch.float64)[:, None]
        kernel = ScaleKernel(
            # the priors that BoTorch had when BayRn was published, and that of the noise below
            MaternKernel(nu=2.5, ard_num_dims=self._d, lengthscale_prior=GammaPrior(3.0, 6.0)),
            outputscale_prior=GammaPrior(2.0, 0.15),
        )
        with seeded(rng):
            self._model = SingleTaskGP(
                x,
                y,
                likelihood=get_gaussian_likelihood_with_gamma_prior(),
                covar_module=kernel,
                outcome_transform=Standardize(m=1),
            )
            fit_gpytorch_mll(ExactMarginalLogLikelihood(self._model.likelihood, self._model))
        self._best = float(y.max())

    def mean(self, points: Matrix) -> Vector:
        """The posterior mean at `points` (n, d), (n,); Rasmussen and Williams, eq. 2.25."""
        with on_one_thread(), torch.no_grad():
            posterior = self._model.posterior(torch.tensor(points, dtype=torch.float64))
            return np.asarray(posterior.mean[:, 0], dtype=np.float64)

    def propose(self) -> Vector:
        """The point (d,) with the largest expected improvement on the best value so far."""
        # log E[max(f(x) - best, 0)]: Ament et al., arXiv 2310.20708, eq. 8 and 9
        bounds = torch.tensor([[0.0] * self._d, [1.0] * self._d], dtype=torch.float64)
        with seeded(self._rng) as seed:
            points, _ = optimize_acqf(
                LogExpectedImprovement(self._model, best_f=self._best),
                bounds=bounds,
                q=1,
                num_restarts=_RESTARTS,
                raw_samples=_RAW,
                options={"seed": seed},
            )
        return np.clip(np.asarray(points[0], dtype=np.float64), 0.0, 1.0)
