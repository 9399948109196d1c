"""The hole comparison of section 5.4: clamped junctions against cemented ones in holes of three sizes."""

from __future__ import annotations

from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from calibration.disk import Conditioning
from tcdyn.simulate.chainsim import through_chains
from tcdyn.simulate.measure import OVERSAMPLING, RATE_Hz, quantised
from tcdyn.simulate.plunge import PlungeOptions, bath_columns, draw_plunge, heat_disk
from tcdyn.simulate.truth import RigTruth, draw_truth, rng_for

Array = NDArray[np.float64]
HOLE_COLUMNS = ("ideal_1_degC", "ideal_2_degC", "d1p3_degC", "d2p2_degC", "d3p0_degC")


def simulate_hole(
    seed: int = 0,
    truth: RigTruth | None = None,
    bath_degC: float = 80.0,
    initial_degC: float = 16.0,
    after_s: float = 60.0,
) -> tuple[pd.DataFrame, dict[str, Any]]:
    """Two-part disk of section 5.4 plunged into hot water: five junctions 3 mm deep, two clamped, three cemented.

    Columns time_s, switch, probe_degC, fluid_degC and ``HOLE_COLUMNS``. The truth holds each chain's lag_s and
    ``"traces"``; a hole of 3 mm lags clearly, those of 1.3 and 2.2 mm hardly.
    """
    rig = truth or draw_truth(seed)
    how = rig.imperfections
    rng = rng_for(seed, "hole")
    o = PlungeOptions(entry_s=10.0, after_s=after_s, initial_degC=initial_degC)
    drawn = draw_plunge(rng, "water", bath_degC, o, how)
    setup = rig.fast.setup
    heating = heat_disk(setup, np.array([3e-3]), drawn)
    cement = {"ideal_1": 0.0, "ideal_2": 0.0, "d1p3": 0.04, "d2p2": 0.10, "d3p0": 0.90}
    base = 0.25 + 0.01 * rng.standard_normal(5)
    chains: list[tuple[float, float, Conditioning]] = [
        (float(b + c * (1 + 0.1 * rng.uniform(-1, 1))), 0.06, setup.conditioning) for b, c in zip(base, cement.values())
    ]
    columns = bath_columns(drawn, how, rng)
    steps = (len(columns["time_s"]) - 1) * OVERSAMPLING + 1
    fine_t = np.arange(steps) / (RATE_Hz * OVERSAMPLING)
    fine = np.repeat(heating.at(fine_t - drawn.entry_s), 5, axis=1)
    read = through_chains(fine, 1 / (RATE_Hz * OVERSAMPLING), OVERSAMPLING, chains)
    if how.static:
        read = read + rng.uniform(-0.1, 0.1, 5)
    if how.noise:
        read = read + 0.13 * rng.standard_normal(read.shape)
    if how.quantise:
        read = quantised(read)
    for k, name in enumerate(HOLE_COLUMNS):
        columns[name] = read[:, k]
    filter_lag = setup.conditioning.lag_s
    lags = {name: tau1 + tau2 + filter_lag for name, (tau1, tau2, _) in zip(cement, chains)}
    traces = pd.DataFrame({"time_s": columns["time_s"], "true_degC": fine[::OVERSAMPLING, 0]})
    return pd.DataFrame(columns), {**vars(drawn), "lag_s": lags, "depth_m": 3e-3, "traces": traces}
