"""Least squares for all fits: from a residual function to optimum, covariance and intervals.

Guarded by ``tests/estimation``: closed forms in ``test_fitting.py``, certified values of NIST in
``test_nist.py``, noise models in ``test_noise_models.py``.

The package contains nothing specific to thermocouples. The caller gives the names of the
parameters, and a function for the residuals (whitened, or in standard deviations of their noise
where that is known) and their Jacobian. Priors are normal, with infinite standard deviation where
there is none.

>>> import numpy as np
>>> from tcdyn.estimation import Problem, minimise, profile
>>> t = np.arange(0.0, 3.0, 0.01)
>>> measured = 5.0 * np.exp(-t / 0.7) + 0.1 * np.random.default_rng(1).standard_normal(len(t))
>>> def residual_and_jacobian(theta):
...     size, tau = theta
...     decay = np.exp(-t / tau)
...     jacobian = np.column_stack([decay, size * decay * t / tau**2])
...     return (size * decay - measured) / 0.1, jacobian / 0.1
>>> problem = Problem(
...     ("size_K", "tau_s"), residual_and_jacobian,
...     prior_mean=np.array([0.0, 0.8]), prior_sd=np.array([np.inf, 0.2]),  # a prior for tau
...     lower=np.array([0.0, 1e-3]), max_step=np.array([np.inf, 0.5]),  # steps of tau <= 0.5 s
... )
>>> best = minimise(problem, np.array([1.0, 1.5]))
>>> best.converged, best.theta.round(2), round(best.u("tau_s"), 4)
(True, array([5.01, 0.69]), 0.0047)
>>> round(best.pulls["tau_s"], 1)  # the data moved the prior mean of 0.8 s by half its uncertainty
-0.5
>>> likelihood_profile = profile(best, "tau_s", step=0.5)
>>> abs(likelihood_profile.high95 - (best.value("tau_s") + 1.96 * best.u("tau_s"))) < 0.001
True

``minimise(problem, start, fixed=rows)`` leaves the combinations rows @ theta unchanged;
``minimise_constrained(best, "tau_s", 0.8)`` fits the other parameters again with one fixed;
``loss="huber"`` is a robust loss for outliers. For correlated residuals there are
``sandwich_covariance`` (an autoregressive model of the residuals), and the discounts
``autocorrelation_factor`` and ``slow_variance_factor`` (covariance factors). Where the model cannot
be computed, ``residual_and_jacobian`` returns None.
"""

from tcdyn.estimation.arma import (
    NoiseModel,
    autocorrelation_factor,
    autocovariance,
    fit_ar,
    fit_arma,
    sandwich_covariance,
)
from tcdyn.estimation.levenberg_marquardt import (
    Loss,
    free_directions,
    lowest_cost,
    minimise,
    minimise_constrained,
    robust_covariance,
)
from tcdyn.estimation.likelihood_profile import Profile, first_crossing, profile
from tcdyn.estimation.linear_elimination import eliminate_linear
from tcdyn.estimation.problem import (
    Evaluate,
    Optimum,
    Problem,
    Status,
    covariance_from_rows,
    inverse,
    is_full_rank,
    orthonormal_basis,
    slow_variance_factor,
)

__all__ = [
    "Evaluate",
    "Loss",
    "NoiseModel",
    "Optimum",
    "Problem",
    "Profile",
    "Status",
    "autocorrelation_factor",
    "autocovariance",
    "covariance_from_rows",
    "eliminate_linear",
    "first_crossing",
    "fit_ar",
    "fit_arma",
    "free_directions",
    "inverse",
    "is_full_rank",
    "lowest_cost",
    "minimise",
    "minimise_constrained",
    "orthonormal_basis",
    "profile",
    "robust_covariance",
    "sandwich_covariance",
    "slow_variance_factor",
]
