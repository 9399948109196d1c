"""The measurement chain: transfer function, exact simulation, state space."""

from tcdyn.chain.chain import (
    NO_CONDITIONING,
    Chain,
    Hold,
    cement_lags,
    conditioning_polynomials,
    delayed,
    discretised,
)

__all__ = ["NO_CONDITIONING", "Chain", "Hold", "cement_lags", "conditioning_polynomials", "delayed", "discretised"]
