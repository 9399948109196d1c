"""A plunge fit with the doubt about the chain's structure added: compared, widened and said."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from tcdyn.plunge.evidence import compare_structures
from tcdyn.plunge.result import PlungeFit, known_burst_u, lag_estimates, share_of, split_lags
from tcdyn.plunge.words import lag_sentence


def with_structure_doubt(fit: PlungeFit) -> PlungeFit:
    """The fit with every other chain structure tried on its plunges, and the lags' covariance widened by the spread.

    The lags stay those of the fit's own structure; ``structures`` holds the comparison.
    """
    own = fit.setup.conditioning.lag_s
    found = compare_structures(
        fit.optimum, fit.scan, fit.priors, [r.entry.u_s for r in fit.runs], own, fit.model_form.u_common_s
    )
    covariance = fit.lag_covariance + found.covariance
    extra = fit.model_form.covariance + found.covariance
    lag = np.array([fit.lag_s[c].value for c in fit.channels])
    _, differential = split_lags(lag, covariance, fit.channels)
    common = fit.scan.estimate(own, float(np.sqrt(max(extra.mean(), 0.0))))
    return replace(
        fit,
        lag_covariance=covariance,
        lag_s=lag_estimates(lag, fit.scan, extra, fit.channels),
        common_lag_s=common,
        differential_lag_s=differential,
        budget=(
            share_of("everything", covariance),
            *fit.budget,
            share_of("choice of chain structure", found.covariance),
        ),
        warnings=(*found.warnings, *fit.warnings),
        sentence=lag_sentence(common, fit.common_lag_s.u, known_burst_u(fit.optimum), len(fit.runs)),
        structures=found,
    )
