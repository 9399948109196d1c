"""False alarms and misses of the judgement of a frequency response without stated uncertainty.

``python -m tests.identify.response_study 100`` prints, for responses of gain 1.8, lags 2.4 s and
0.5 s and a dead time of 0.2 s with independent errors, how many fits of the right structure have a
warning about their residuals, and how many of a structure that is too small have none.
"""

from __future__ import annotations

import sys

import numpy as np

from tcdyn.identification import Response, fit_response

RIGHT = "P2D"
TOO_SMALL = ("P1D", "P1")


def response(n_frequencies: int, share: float, rng: np.random.Generator) -> Response:
    """A response with errors of ``share`` of the magnitude in each part."""
    frequency_Hz = np.geomspace(0.005, 2.0, n_frequencies)
    s = 2j * np.pi * frequency_Hz
    h = 1.8 * np.exp(-0.2 * s) / ((1 + 2.4 * s) * (1 + 0.5 * s))
    error = rng.normal(size=n_frequencies) + 1j * rng.normal(size=n_frequencies)
    return Response(frequency_Hz, h * (1 + share * error))


def alarms(model: str, n_frequencies: int, share: float, draws: int) -> float:
    """Share of fits with a warning or an error about their residuals."""
    rng = np.random.default_rng(52)
    codes = {"response.systematic", "response.poor_fit"}
    count = 0
    for _ in range(draws):
        fit = fit_response(response(n_frequencies, share, rng), model)
        count += any(finding.code in codes for finding in fit.findings)
    return count / draws


def main(draws: int) -> None:
    """Print the shares of alarms."""
    print("frequencies  errors [%]  " + "  ".join(f"{m:>5}" for m in (RIGHT, *TOO_SMALL)))
    for n_frequencies in (8, 15, 25, 60):
        for share in (0.002, 0.02, 0.1):
            shares = [alarms(m, n_frequencies, share, draws) for m in (RIGHT, *TOO_SMALL)]
            texts = "  ".join(f"{value:5.2f}" for value in shares)
            print(f"{n_frequencies:11d}  {100 * share:10.1f}  {texts}")


if __name__ == "__main__":
    main(int(sys.argv[1]))
