r"""Compensation against named baselines, with ratios in brackets.

Run: ``python -m tests.benchmarks.compensate [case|unload|noise|log]``."""

from __future__ import annotations

import contextlib
import io
import sys
import time
import warnings

import numpy as np
from numpy.typing import NDArray
from scipy import signal

from tcdyn.chain import NO_CONDITIONING, Chain
from tcdyn.rig.disk import Conditioning
from tcdyn.smoothing import deconvolve, proper_inverse, smooth
from tests.smoothing.live_world import with_delay
from tests.smoothing.test_noise import CHAIN, DT_S, EVENT_S, disturbance, logged

DELAYED_RECORDS = 4  # of the records with a delay: they need minutes
RIG_FILTER = Conditioning(cutoff_Hz=4.0, poles=2)

Array = NDArray[np.float64]


def case_b(records: int = 10) -> None:
    """Case B of the anchors; its baselines: smoother 0.249, causal Kalman filter 1.01, tuned FIR
    0.69 degC rms."""
    dt = 0.05
    n = 800
    rng = np.random.default_rng(0)
    fine = 25 + 155 * (1 - np.exp(-np.maximum(np.arange(n * 20) * dt / 20 - 5, 0) / 3))
    chain = Chain((1.0,), conditioning=NO_CONDITIONING)
    x = fine[::20]
    t = np.arange(n) * dt
    y = chain.response(fine, dt / 20)[::20, None] + 0.2 * rng.standard_normal((n, records))
    middle = slice(60, 740)
    transient = (t >= 4.75) & (t <= 10)
    edges = np.r_[0:60, 740:800]
    print(
        f"\nCase B, {records} records: rms (ratio to the anchor), coverage all / transient / edges"
    )

    def print_row(name: str, estimate: Array, sd: Array | None, baseline: float) -> None:
        error = estimate - x[:, None]
        rms = float(np.sqrt(np.mean(error[middle] ** 2)))
        cover = ""
        if sd is not None:
            covered = np.abs(error) < 1.96 * sd
            shares = [covered.mean(), covered[transient].mean(), covered[edges].mean()]
            cover = " / ".join(f"{100 * share:.1f}" for share in shares) + " %"
        print(f"  {name:42s} {rms:6.3f} K ({rms / baseline:.2f})  {cover}")

    print_row("uncorrected", y, None, 9.4)
    for name, events in (
        ("smoother, event detected", ()),
        ("smoother, event given", (5.0,)),
    ):
        runs = [smooth(y[:, k], dt, chain, events_s=events) for k in range(records)]
        print_row(
            name,
            np.column_stack([r.temperature for r in runs]),
            np.column_stack([r.sd for r in runs]),
            0.249,
        )
    runs = []
    for k in range(records):
        sampled_chain = Chain((1.0 + 0.05 * rng.standard_normal(),), conditioning=NO_CONDITIONING)
        runs.append(smooth(y[:, k], dt, sampled_chain, lag_covariance=[[0.05**2]]))
    print_row(
        "smoother, lag sampled from 1.0 +- 0.05 s",
        np.column_stack([r.temperature for r in runs]),
        np.column_stack([r.sd for r in runs]),
        0.249,
    )
    plain = smooth(y, dt, chain, find_events=False)
    print_row("smoother, no event", plain.temperature, plain.sd, 0.249)
    for criterion in ("gcv", "discrepancy", "l-curve"):
        ours, _ = deconvolve(y, dt, chain, criterion=criterion)
        print_row(f"deconvolution, {criterion}", ours.temperature, ours.sd, 0.249)
    for delay_s in (0.5, 1.0, 2.0):
        name = f"smoother, fixed delay of {delay_s} s, rows complete after it"
        print_row(name, *with_delay(y[:, :DELAYED_RECORDS], dt, chain, delay_s, 1), 1.01)
    print_row("proper inverse, 1.5 Hz", proper_inverse(chain, dt, 1.5)(y), None, 1.01)
    for band_Hz in (0.6, 0.9, 1.5):
        fir_result = pydynamic_fir(y, dt, chain, band_Hz)
        if fir_result is None:
            print(
                "  PyDynamic is not installed: its FIR method is left out (pip install PyDynamic)"
            )
            break
        print_row(f"PyDynamic LSFIR, {band_Hz} Hz", *fir_result, 0.69)


def pydynamic_fir(
    y: Array, dt: float, chain: Chain, band_Hz: float, order: int = 24
) -> tuple[Array, Array] | None:
    """The archived PTB library: least-squares inverse FIR, low-pass FIR, GUM propagation. None if
    not installed."""
    with warnings.catch_warnings(), contextlib.redirect_stdout(io.StringIO()):
        warnings.simplefilter("ignore")
        try:
            from PyDynamic.model_estimation.fit_filter import LSFIR
            from PyDynamic.uncertainty.propagate_filter import FIRuncFilter
        except ImportError:
            return None
        f = np.linspace(0.0, 1.2 * band_Hz, 80)
        response = chain.frequency_response(f)
        real_and_imaginary = np.concatenate([response.real, response.imag])
        taps, _ = LSFIR(real_and_imaginary, order, f, 1 / dt, order // 2, verbose=False, inv=True)
        low = signal.firwin(2 * order + 1, band_Hz, fs=1 / dt)
        runs = [
            FIRuncFilter(
                column, 0.2, taps, np.zeros((order + 1, order + 1)), order // 2 + order, low
            )
            for column in y.T
        ]
    return np.column_stack([r[0] for r in runs]), np.column_stack([r[1] for r in runs])


def junction_after_unloading(dt: float, n: int, off_s: float, fine: int = 8) -> tuple[Array, Array]:
    """Temperature 1.25 mm below the surface of a 17.6 mm slab whose flux stops at ``off_s``, and
    its fine sampling."""
    cells = 60
    length = 17.6e-3
    conductivity = 41.0
    heat = 7850 * 470.0
    h = 700.0
    dx = length / cells
    a = np.zeros((cells, cells))
    for i in range(cells - 1):
        a[i : i + 2, i : i + 2] += conductivity / heat / dx**2 * np.array([[-1, 1], [1, -1]])
    a[0, 0] -= 1 / (1 / h + dx / 2 / conductivity) / (heat * dx)
    rates, modes = np.linalg.eigh(a)
    amplitudes = modes[0] / (heat * dx) / rates
    t = np.arange(n * fine) * dt / fine
    mode_at_junction = modes[int(1.25e-3 / dx)]
    x = np.full(len(t), 0.0)
    time_since_unloading = np.maximum(t - off_s, 0)
    for k in range(cells):
        x -= mode_at_junction[k] * amplitudes[k] * np.exp(rates[k] * time_since_unloading)
    x *= 12.0 / (x[0] - np.interp(off_s + 1.0, t, x))
    return x[::fine] + 60.0, x + 60.0


def unloading(records: int = 10) -> None:
    """12 degC in the first second, noise 0.15: the smoother, and one with the true spectrum of the
    cooling."""
    dt = 1 / 75
    n = 3000
    unload_s = 20.0067
    x, fine = junction_after_unloading(dt, n, unload_s)
    chain = Chain((0.6, 0.07), conditioning=RIG_FILTER)
    rng = np.random.default_rng(1)
    clean = chain.response(fine, dt / 8)[::8, None]
    y = clean + 0.15 * rng.standard_normal((n, records))
    t = np.arange(n) * dt
    after = (t >= unload_s) & (t < unload_s + 5)
    ours = smooth(y, dt, chain, events_s=(unload_s,))
    error = ours.temperature - x[:, None]
    raw = np.sqrt(np.mean((y - x[:, None])[after] ** 2))
    rms = np.sqrt(np.mean(error[after] ** 2))
    coverage = np.mean(np.abs(error[after]) < 1.96 * ours.sd[after])
    print("\nUnloading at e, 5 s after it, K rms")
    print(f"  raw {raw:.2f}, smoother {rms:.3f} (coverage {100 * coverage:.0f} %)")
    with_true_intensity = smooth(
        y, dt, chain, events_s=(unload_s,), noise_sd=0.15, intensity=best_intensity(x, dt, unload_s)
    )
    oracle_rms = np.sqrt(np.mean((with_true_intensity.temperature - x[:, None])[after] ** 2))
    print(
        f"  smoother given the true squared curvature as its intensity: {oracle_rms:.3f} "
        f"(ratio {rms / oracle_rms:.2f})"
    )


def best_intensity(x: Array, dt: float, off: float):
    """The mean of the true squared curvature, q = x''^2 dt, in segments after the event."""
    from tcdyn.smoothing import Intensity

    starts_s = off + np.array([0.0, 0.3, 1.0, 3.0, 10.0])
    first = int(np.ceil(off / dt)) + 1
    squared_curvature = np.diff(x[first:], 2) ** 2 / dt**3
    time_s = off + (np.arange(len(squared_curvature)) + 1) * dt
    segment = np.searchsorted(starts_s, time_s, side="right") - 1
    levels = [float(squared_curvature[segment == k].mean()) for k in range(len(starts_s))]
    return Intensity((0.0, *starts_s.tolist()), (1e-9, *levels))


def case_c(records: int = 12) -> None:
    """A kink of 12 K at 1 s and a slow oscillation under five kinds of noise, within -1 s and +5 s
    of the kink."""
    print("\nCase C: rms [K], coverage of the 95 % interval")
    for kink, duration_s in ((True, 40.0), (False, 60.0), (False, 200.0)):
        t, true_temperature, clean = logged(kink, duration_s)
        in_window = (
            (t > EVENT_S - 1) & (t < EVENT_S + 5) if kink else (t > 1) & (t < duration_s - 1)
        )
        for noise_kind in (
            "ar0.0",
            "ar0.2",
            "ar0.4",
            "ar0.6",
            "ar0.8",
            "before",
            *(["hum"] if kink else []),
        ):
            squares = []
            covered = []
            for seed in range(500, 500 + records):
                y = clean + disturbance(noise_kind, np.random.default_rng(seed), len(t))
                result = smooth(y, DT_S, CHAIN, events_s=(EVENT_S,) if kink else ())
                error = (result.temperature[:, 0] - true_temperature)[in_window]
                squares.append(np.mean(error**2))
                covered.append(np.mean(np.abs(error) < 1.96 * result.sd[in_window, 0]))
            print(
                f"  {'kink' if kink else f'swing, {duration_s:.0f} s'}, {noise_kind}: "
                f"{np.mean(squares) ** 0.5:.3f} K, {100 * np.mean(covered):.0f} %"
            )


def complete_log() -> None:
    """12 channels, 2000 s at 75 Hz, with standard deviations; the causal inverse in samples per
    second."""
    dt = 1 / 75
    n = 150_000
    off = 1500.0067
    _, fine = junction_after_unloading(dt, n, off, 2)
    chain = Chain((0.6, 0.07), conditioning=RIG_FILTER)
    rng = np.random.default_rng(2)
    flux = signal.lfilter([1e-3], [1, -0.999], rng.standard_normal(2 * n))
    y = chain.response(fine + 3 * flux, dt / 2)[::2, None] + 0.15 * rng.standard_normal((n, 12))
    wall = time.perf_counter()
    cpu = time.process_time()
    smooth(y, dt, chain, events_s=(off,))
    print(
        f"\n12 channels x {n} samples smoothed with sd: {time.perf_counter() - wall:.2f} s wall, "
        f"{time.process_time() - cpu:.2f} s of one core (target: 5 s)"
    )
    f = proper_inverse(chain, dt, 2.0)
    f(y[:100])
    wall = time.process_time()
    f(np.ascontiguousarray(y.T).ravel())
    rate = y.size / (time.process_time() - wall) / 1e6
    print(f"causal inverse: {rate:.0f} million samples/s (target: 10)")
    wall = time.process_time()
    with_delay(y[:2250], dt, chain, 2.0)
    print(
        f"fixed delay of 2 s, 12 channels, no event: {(time.process_time() - wall) / 30:.2f} s "
        "of one core for each second of the log"
    )


if __name__ == "__main__":
    for name, run in (
        ("case", case_b),
        ("unload", unloading),
        ("noise", case_c),
        ("log", complete_log),
    ):
        if len(sys.argv) < 2 or name in sys.argv[1:]:
            run()
