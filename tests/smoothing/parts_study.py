"""Are all parts of a compensated temperature's uncertainty there? Ovens with a biased and drifting
reference, chains whose lags and their division are drawn from what the record states, a trace that
swings and bends, logs with noise.

``python -m tests.smoothing.parts_study RIGS SEED`` prints how many 95 % intervals hold: of samples,
of means over two seconds, of differences between channels' means. Lags and filter are simulated by
recursions of their own on a grid twenty times finer.
"""

from __future__ import annotations

import sys
import tempfile
from datetime import date
from pathlib import Path

import numpy as np
import pandas as pd

from calibration.static_lines import fit_static_lines
from tcdyn.core.estimate import Estimate
from tcdyn.rig.disk import CHANNELS
from tcdyn.rig.record import ChainRecord, ChannelChain, DiskRecord
from tcdyn.rig.rigfile import parse_rig
from tcdyn.workflows.compensate import compensate_log
from tests.rig.log_cases import oven_frame, oven_truth
from tests.sensors.sensor_world import FINE, lagged

STATED = {"reference_u_K": 0.03, "reference_drift_K_per_year": 0.03, "reference_date": "2024-01-01"}
ON = "2026-01-01T09:00:00+00:00"
COMMON_U_S, OWN_U_S, SPLIT_U_S, SECOND_S = 0.03, 0.01, 0.03, 0.1
DT_S, SAMPLES, NOISE_K = 1 / 75, 2250, 0.1
BEND_S, FROM_S, LONG_S = 15.0, 15.5, 2.0


def record_of(seed: int, rng: np.random.Generator) -> DiskRecord:
    """A record whose reference was off by its certificate's error and its drift."""
    rig = parse_rig({"traceability": STATED}, "rig.toml").common
    frame = oven_frame(seed)
    frame["prt_degC"] += rng.normal(0, 0.03) + rng.uniform(-0.06, 0.06)
    lines = fit_static_lines(
        frame, prt_shared_u_degC=rig.traceability.shared_u_K(date(2026, 1, 1))
    ).lines
    lags = 0.70 + 0.01 * np.arange(6)
    covariance = COMMON_U_S**2 * np.ones((6, 6)) + OWN_U_S**2 * np.eye(6)
    u, filter_s, mean = float(np.sqrt(covariance[0, 0])), rig.conditioning.lag_s, float(lags.mean())
    chain = ChainRecord(
        structure="P2",
        channels={
            c: ChannelChain(
                taus_s=(lag - filter_s - SECOND_S, SECOND_S),
                lag_s=Estimate.normal(lag, u),
                split_u_s=SPLIT_U_S,
            )
            for c, lag in zip(CHANNELS, lags.tolist())
        },
        covariance=covariance.tolist(),
        common_lag_s=Estimate.normal(mean, COMMON_U_S),
        differential_lag_s={
            c: Estimate.normal(lag - mean, OWN_U_S) for c, lag in zip(CHANNELS, lags.tolist())
        },
    )
    return DiskRecord(disk="fast", created=ON, static=lines, chain=chain, setup=rig)


def one(seed: int) -> tuple[float, list[bool], list[bool]]:
    """Share of samples whose interval holds; of means; of differences of means."""
    rng = np.random.default_rng([seed, 7])
    record = record_of(seed, rng)
    gain, offset = oven_truth(seed)
    fine = np.arange(SAMPLES * FINE) * DT_S / FINE
    common, columns, truth = rng.normal(0, COMMON_U_S), {"time_s": fine[::FINE]}, []
    pole = 1 / (2 * np.pi * record.conditioning.cutoff_Hz)
    for k, c in enumerate(CHANNELS):
        phase, size = rng.uniform(0, 6, 2), rng.uniform(0.5, 1.5)
        x = 90 + 6 * size * np.sin(fine / 5 + phase[0]) + 3 * size * np.sin(fine / 1.7 + phase[1])
        x += -30 * size * (1 - np.exp(-np.clip(fine - BEND_S, 0, None) / 4.0))
        stated = record.chain.channels[c].taus_s if record.chain else ()
        split = rng.normal(0, SPLIT_U_S)
        second = float(np.clip(SECOND_S - split, 0.005, None))
        first = sum(stated) + common + rng.normal(0, OWN_U_S) - second
        y = lagged(x, (first, second, *[pole] * record.conditioning.poles), DT_S / FINE)[::FINE]
        columns[f"{c}_degC"] = (y + NOISE_K * rng.standard_normal(SAMPLES) - offset[k]) / gain[k]
        truth.append(x[::FINE])
    columns |= {"fluid_degC": np.full(SAMPLES, 60.0), "probe_degC": np.full(SAMPLES, 60.0)}
    columns["switch"] = (columns["time_s"] >= BEND_S).astype(float)
    with tempfile.TemporaryDirectory() as folder:
        log = Path(folder) / "plunge.csv"
        pd.DataFrame(columns).to_csv(log, index=False)
        done = compensate_log(log, {"fast": record})
    x = np.stack(truth, axis=1)
    got = np.stack([done.frame[f"{c}_degC"] for c in CHANNELS], axis=1)
    u = np.stack([done.frame[f"{c}_u_K"] for c in CHANNELS], axis=1)
    kept = slice(75, -75)
    means = done.covariance(LONG_S, FROM_S)
    rows = np.isin(np.round(columns["time_s"], 4), np.round(means["time_s"], 4))
    gap = np.array(means["mean_degC"]) - x[rows].mean(axis=0)
    variance = np.diag(np.array(means["mean_covariance_K2"]))
    apart = np.array(means["difference_u_K"])
    pairs = [(0, 3), (1, 4), (2, 5)]
    return (
        float(np.mean(np.abs(got - x)[kept] < 1.96 * u[kept])),
        (np.abs(gap) < 1.96 * np.sqrt(variance)).tolist(),
        [bool(abs(gap[i] - gap[j]) < 1.96 * apart[i, j]) for i, j in pairs],
    )


def main(rigs: int, seed: int) -> None:
    """Print the shares."""
    samples, means, apart = zip(*(one(seed + k) for k in range(rigs)))
    print(
        f"{rigs} records: 95 % intervals hold {100 * np.mean(samples):.1f} % of samples (sd "
        f"over records {100 * np.std(samples):.0f} %), {100 * np.mean(means):.1f} % of means, "
        f"{100 * np.mean(apart):.1f} % of differences of means"
    )


if __name__ == "__main__":
    main(int(sys.argv[1]), int(sys.argv[2]) if len(sys.argv) > 2 else 0)
