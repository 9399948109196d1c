"""Least squares: residual, Jacobian and priors to optimum, covariance and intervals."""
