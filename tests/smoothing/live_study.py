"""Hours followed live, many channels at once: ``python -m tests.smoothing.live_study HOURS SEED [white|coloured]``.

Every ten minutes of every six channels are a world of their own; its noise is learnt from its first seconds.
``python -m tests.smoothing.live_study HOURS SEED day BEHIND_S``: one log of so many hours, three unloadings, noise of
three channels from before the filter, through ``tcdyn follow`` itself.
"""

from __future__ import annotations

import subprocess
import sys
import tempfile
import time
from itertools import pairwise
from pathlib import Path

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from tcdyn.chain import Chain
from tcdyn.rig.disk import Conditioning
from tcdyn.smoothing import LiveSmoother, smooth
from tcdyn.workflows.log_source import INTENSITY_K2_S3
from tcdyn.workflows.warm_up import _noise
from tests.smoothing.live_world import NAMES, TAUS_S, World, record, world

RIG_FILTER = Conditioning(cutoff_Hz=4.0, poles=2)

Array = NDArray[np.float64]
DT_S, TOTAL_S, SETTLED_S, LEARN_S, AT_ONCE = 1 / 75, 600.0, 5.0, 5.0, 8
CHAIN = Chain(TAUS_S, conditioning=RIG_FILTER)


def learnt(made: World) -> tuple[Array, Array]:
    """Noise of the six channels [K] as ``tcdyn follow`` learns it: white, and from before the filter."""
    first = made.readings[: int(LEARN_S / DT_S)]
    levels = _noise({str(c): (y, CHAIN.conditioning) for c, y in enumerate(first.T)}, DT_S, None)
    return tuple(np.array(list(levels[k].values())) for k in ("noise_K", "before_K"))  # type: ignore[return-value]


def lived(worlds: list[World], lag: int) -> tuple[Array, Array]:
    """Live answers and their sd, each (N, 6 a world), at the samples they are for."""
    after, before = (np.concatenate(part) for part in zip(*map(learnt, worlds)))
    y = np.concatenate([w.readings for w in worlds], axis=1)
    engine = LiveSmoother.from_chains(
        [CHAIN] * y.shape[1], DT_S, after, INTENSITY_K2_S3["ehl"], lag, before
    )
    _, x, sd, _ = engine.run(
        engine.initial_state(y[0]), np.concatenate([y, np.full((lag, y.shape[1]), np.nan)])
    )
    return x[lag:], sd[lag:]


def main(hours: float, seed: int, before: float, batch: bool) -> None:
    count = max(round(hours * 3600 / TOTAL_S), 1)
    for lag in (0, round(0.5 / DT_S)):
        started, parts = time.process_time(), []
        for a in range(0, count, AT_ONCE):
            seeds = range(seed + a, seed + min(a + AT_ONCE, count))
            worlds = [world(TOTAL_S, before, s, drops_K=(12.0, 3.0, 12.0)) for s in seeds]
            x, sd = lived(worlds, lag)
            for k, (one, s) in enumerate(zip(worlds, seeds)):
                own = slice(6 * k, 6 * k + 6)
                parts.append(judged(one, x[:, own], sd[:, own], s, batch and lag > 0))
        said(
            parts,
            f"{'white' if before == 0 else 'coloured'}, {lag * DT_S:.1f} s behind, {count} x 6 channels",
        )
        print(f"  {time.process_time() - started:.0f} s of CPU", flush=True)


def judged(made: World, x: Array, sd: Array, seed: int, batch: bool) -> dict[str, Array]:
    """Errors in K and in sd, where they were made; against the batch smoother in sd."""
    after = made.time_s[:, None] - made.slope_changes_s
    near = np.repeat(((after > 0) & (after < 2.0)).any(axis=1)[:, None], 6, axis=1)
    other = smooth(made.readings, DT_S, CHAIN).temperature if batch else x
    kept = {
        "error": x - made.true[:, None],
        "sd": sd,
        "near": near,
        "burst": made.burst & ~near,
        "apart": x - other,
    }
    kept |= {
        "time": np.repeat(made.time_s[:, None], 6, axis=1),
        "channel": np.tile(np.arange(6), (len(x), 1)),
    }
    kept["seed"] = np.full(x.shape, seed)
    return {
        k: np.broadcast_to(v, x.shape)[made.time_s > SETTLED_S].ravel() for k, v in kept.items()
    }


def said(parts: list[dict[str, Array]], title: str) -> None:
    each = {k: np.concatenate([p[k] for p in parts]) for k in parts[0]}
    error, z = np.abs(each["error"]), np.abs(each["error"] / each["sd"])
    near, burst = each["near"].astype(bool), each["burst"].astype(bool)
    print(
        f"{title}: largest {error.max():.2f} K, {z.max():.1f} sd; above 5 K and 6 sd: {np.sum((error > 5) & (z > 6))}"
    )
    for name, where in (
        ("all", z >= 0),
        ("2 s after kinks", near),
        ("bursts", burst),
        ("rest", ~near & ~burst),
    ):
        rms, held = np.sqrt(np.mean(error[where] ** 2)), 100 * np.mean(z[where] < 1.96)
        worst = f"largest {error[where].max():.2f} K, {z[where].max():.1f} sd, "
        worst += f"median sd {np.median(each['sd'][where]):.3f}"
        print(
            f"  {name:16s} rms {rms:.3f} K, coverage {held:.2f} %, {worst}, above 6 sd {np.sum(z[where] > 6)}, "
            f"5 K {np.sum(error[where] > 5)}"
        )
    if np.any(each["apart"]):
        apart = np.abs(each["apart"] / each["sd"])
        print(
            f"  from batch: largest {apart.max():.1f} sd, below 1 sd {100 * np.mean(apart < 1):.2f} %"
        )
    order = np.argsort(-z)
    seen: set[tuple[float, ...]] = set()
    for i in order:
        key = (each["seed"][i], each["channel"][i], round(each["time"][i] / 2))
        if key not in seen and len(seen) < 6:
            seen.add(key)
            print(
                f"    seed {int(each['seed'][i])} channel {int(each['channel'][i])} at {each['time'][i]:.3f} s: "
                f"{each['error'][i]:+.2f} K, {z[i]:.1f} sd, near {near[i]}, burst {burst[i]}"
            )


def day(hours: float, seed: int, behind_s: float, folder: Path) -> None:
    """One log of ``hours`` through the command, its noise white in three channels, from before the filter in three."""
    total, before = 3600.0 * hours, np.repeat([0.0, 0.97], 3)
    cuts = [*np.arange(0.0, total, TOTAL_S), total]
    log, out, disk = folder / "log.csv", folder / "out.csv", folder / "fast.disk.json"
    disk.write_text(record().to_json(), encoding="utf-8")
    known = []
    for a, b in pairwise(cuts):
        made = world(total, before, seed, part_s=(a, b))
        made.log().to_csv(log, index=False, mode="a", header=a == 0.0)
        known.append(
            World(made.time_s, made.true, made.readings[:, :0], made.slope_changes_s, made.burst)
        )
    command = [
        Path(sys.executable).parent / "tcdyn",
        "follow",
        log,
        "--record",
        disk,
        "--out",
        out,
        "--behind-s",
        behind_s,
    ]
    print(
        subprocess.run(
            [*map(str, command), "--idle-s", "1"], capture_output=True, text=True, check=False
        ),
        flush=True,
    )
    sd_names, parts = [n.replace("_degC", "_u_K") for n in NAMES], []
    columns = ["time_s", *NAMES, *sd_names]
    for made, done in zip(known, pd.read_csv(out, usecols=columns, chunksize=len(known[0].time_s))):
        assert np.allclose(done["time_s"], made.time_s, atol=1e-3)
        parts.append(judged(made, done[NAMES].to_numpy(), done[sd_names].to_numpy(), seed, False))
    for name, own in (
        ("white", range(3)),
        ("from before the filter", range(3, 6)),
        ("all", range(6)),
    ):
        kept = [{k: v[np.isin(p["channel"], own)] for k, v in p.items()} for p in parts]
        said(
            kept,
            f"{hours:g} h, {behind_s:g} s behind, {name}: {sum(len(p['error']) for p in kept)} answers",
        )
    rows = sum(len(made.time_s) for made in known)
    print(
        f"rows {rows}, written {sum(len(p['error']) for p in parts) // 6 + np.sum(known[0].time_s <= SETTLED_S)}"
    )


if __name__ == "__main__" and "day" in sys.argv:
    with tempfile.TemporaryDirectory() as own_folder:
        day(float(sys.argv[1]), int(sys.argv[2]), float(sys.argv[4]), Path(own_folder))
elif __name__ == "__main__":
    main(
        float(sys.argv[1]),
        int(sys.argv[2]),
        0.97 if "coloured" in sys.argv else 0.0,
        "batch" in sys.argv,
    )
