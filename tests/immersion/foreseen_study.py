"""Uncertainties predicted by ``design``, with their 10 to 90 % band, against those of ``calibrate``
on simulations.

``python tests/immersion/foreseen_study.py N SEED``: N disks plunged in hot oil at 110 and 138 degC,
h(T) of five published forms, lags of 0.65 s within 20 %. Each is fitted, with the comparison of
chain structures, and its u is compared with the band.
"""

from __future__ import annotations

import sys

import numpy as np
from forms_study import BATHS, FORMS, simulated_plunges

from immersion.plunge_fit import identify_plunges, with_structure_uncertainty
from tcdyn.design.plans import PlungePlan, predict_plunges
from tcdyn.rig.rigfile import load_rig

CASE = "oil, heated"
EXPECTED_S = 0.65


def main(disks: int, seed: int) -> None:
    """One line for each disk, then the band and the shares within, above and below."""
    setup = load_rig().disk_setup("fast")
    baths = BATHS[CASE][3]
    predicted = predict_plunges(
        [PlungePlan(bath_degC=b, initial_degC=26.0) for b in baths], setup, lag_s=EXPECTED_S
    )
    _, chosen, runs = simulated_plunges(CASE, disks, seed, lag_s=EXPECTED_S)
    uncertainties = []
    for k, form in enumerate(chosen):
        fit = with_structure_uncertainty(identify_plunges(runs[2 * k : 2 * k + 2], setup))
        differential = np.sqrt(np.mean([e.u**2 for e in fit.differential_lag_s.values()]))
        uncertainties.append((fit.common_lag_s.u, differential))
        print(
            f"{FORMS[form].__name__:10} lag {fit.common_lag_s}, differences u {differential:.4f}",
            flush=True,
        )
    common, differential = np.array(uncertainties).T
    low_u, high_u = np.quantile(common, [0.1, 0.9])
    low = predicted.low_s
    high = predicted.high_s
    print(
        f"{disks} disks: u of the common lag predicted {predicted.u_common_s:.3f} s, band "
        f"{low:.3f} to {high:.3f}; fitted {np.sqrt(np.mean(common**2)):.3f} rms, {low_u:.3f} to "
        f"{high_u:.3f}; within {100 * np.mean((common >= low) & (common <= high)):.0f} %, below "
        f"{100 * np.mean(common < low):.0f} %, above {100 * np.mean(common > high):.0f} %; "
        f"differences predicted {predicted.u_differential_s:.4f}, fitted "
        f"{np.sqrt(np.mean(differential**2)):.4f} rms"
    )


if __name__ == "__main__":
    main(int(sys.argv[1]), int(sys.argv[2]))
