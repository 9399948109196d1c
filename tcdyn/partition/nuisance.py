"""What nobody measured in this test, with its standard uncertainty and its effect on the predicted outer row."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy import signal

from calibration.disk import CHANNELS, INNER_ROW, OUTER_ROW
from calibration.rig import UncertaintyTable
from tcdyn.chain import discretised
from tcdyn.conduction.bank import lag_bank
from tcdyn.conduction.modal import RimGains
from tcdyn.partition.window import (
    GRADIENT_STEP_M,
    INNER,
    NOMINAL,
    DiskWindow,
    Perturbation,
    above_inner_row,
    perturbed_gains,
)
from tcdyn.traces import DiskTraces

MATERIAL_STEP = 0.01
SMOOTH_RATE_S = 0.5
SPLIT_SD_S = 0.03  # a plunge hardly tells how a channel's lag is split in two
MODEL_K = 0.03  # what rim and mesh leave unexplained at a junction, against whole-disk solutions


@dataclass(frozen=True)
class Nuisances:
    """``names`` (Q,), ``sd`` (Q,) in the unit of each, ``shared`` marks those that both disks have in common.

    ``effect`` (Q, R, 3): change of the predicted reading per unit of the nuisance [K per unit], at the share and h
    at which it was worked out.
    """

    names: tuple[str, ...]
    sd: NDArray[np.float64]
    effect: NDArray[np.float64]
    shared: tuple[bool, ...]


def nuisances(
    window: DiskWindow,
    disk: DiskTraces,
    stretch_readings: NDArray[np.float64],
    dt_s: float,
    share: float,
    h_W_m2K: float,
    parting_u_s: float = 0.0,
) -> Nuisances:
    """All nuisances of one disk about the point (share, h).

    ``stretch_readings`` (N, 6): the temperatures that drove ``window``. Static lines of all six channels, depths of
    all six junctions, differential lags, steel, washer, half-width of the contact, friction scale, ambient, each to
    ``disk.uncertainty``, and the instant of parting, known to ``parting_u_s``.
    """
    u = disk.uncertainty
    gains = window.gains(h_W_m2K)
    rest, power = window.answer(gains)
    base = rest + share * power
    static = gains.direct + gains.gains.sum(axis=2)  # (5, 3): response to a lasting unit of each input
    names: list[str] = []
    sd: list[float] = []
    effect: list[NDArray[np.float64]] = []
    shared: list[bool] = []

    def add(name: str, spread: float, change: NDArray[np.float64], both: bool = False) -> None:
        if spread > 0:
            names.append(name)
            sd.append(spread)
            effect.append(np.broadcast_to(change, base.shape))
            shared.append(both)

    for j, ch in enumerate(OUTER_ROW):
        one = np.zeros(3)
        one[j] = 1.0
        add(f"static {ch}", float(np.hypot(disk.static_u_K[CHANNELS.index(ch)], MODEL_K)), one)
    for i, ch in enumerate(INNER_ROW):
        add(f"static {ch}", float(disk.static_u_K[CHANNELS.index(ch)]), -static[1 + i])
    for name, p, spread, both in _material(u):
        moved = window.answer(window.gains(h_W_m2K, p))
        add(name, spread, (moved[0] + share * moved[1] - base) / MATERIAL_STEP, both)
    for j, ch in enumerate(OUTER_ROW):
        shift = [0.0, 0.0, 0.0]
        shift[j] = 0.05e-3
        moved = window.answer(window.gains(h_W_m2K, replace(NOMINAL, depth_m=(shift[0], shift[1], shift[2]))))
        add(f"depth {ch}", u.depth_mm * 1e-3, (moved[0] + share * moved[1] - base) / shift[j])
    slopes = boundary_gradient(window, share, h_W_m2K)
    for i, ch in enumerate(INNER_ROW):
        add(f"depth {ch}", u.depth_mm * 1e-3, _through_boundary(window, slopes[:, i], dt_s, gains, i))
    add("parting", parting_u_s, -share * np.gradient(power, window.blocks.time_s, axis=0), True)
    add("friction", u.friction_rel, share * power, True)
    add("ambient", u.ambient_K, static[4], True)
    _lags(window, disk, stretch_readings, dt_s, base, gains, add)
    return Nuisances(tuple(names), np.array(sd), np.stack(effect), tuple(shared))


def _material(u: UncertaintyTable) -> Sequence[tuple[str, Perturbation, float, bool]]:
    e = MATERIAL_STEP
    return (
        ("conductivity", Perturbation(conductivity=e), u.conductivity_rel, True),
        ("heat capacity", Perturbation(heat_capacity=e), u.heat_capacity_rel, True),
        ("washer", Perturbation(washer=e), u.washer_rel, True),
        ("half-width", Perturbation(half_width=e), u.half_width_rel, True),
    )


def boundary_gradient(window: DiskWindow, share: float, h_W_m2K: float) -> NDArray[np.float64]:
    """Rise of temperature with radius at d, b, f over the stretch, (N, 3) [K/m], from the model itself.

    A junction that lies deeper than stated reads too low for the model's inner radius by this slope times its error.
    Worked out on block means and held between them.
    """
    extra = above_inner_row(window.setup)
    g = perturbed_gains(window.setup, h_W_m2K, window.half_width_m, window.rates_1_s, NOMINAL, window.profile, extra)
    rest, power = window.answer(g)
    rise = (rest + share * power)[:, 3:] - window.inputs[:, 1:4]
    smooth = np.column_stack([np.interp(window.time_s, window.blocks.time_s, r) for r in rise.T])
    return smooth / GRADIENT_STEP_M


def _through_boundary(
    window: DiskWindow, added: NDArray[np.float64], dt_s: float, gains: RimGains, i: int
) -> NDArray[np.float64]:
    """Answer of the outer row to an addition ``added`` (N,) to boundary reading i; (R, 3)."""
    bank = window.blocks.mean(lag_bank(added, dt_s, window.rates_1_s))
    return np.asarray(window.blocks.mean(added)[:, None] * gains.direct[1 + i][None] + bank @ gains.gains[1 + i].T)


def _lags(
    window: DiskWindow,
    disk: DiskTraces,
    readings: NDArray[np.float64],
    dt_s: float,
    base: NDArray[np.float64],
    gains: RimGains,
    add: Callable[[str, float, NDArray[np.float64]], None],
) -> None:
    """Errors of the differential lags: a reading that lags by more than stated shows its own past."""
    u_diff = differential_lag_u_s(disk.lag_covariance_s2)
    width = max(int(round(SMOOTH_RATE_S / dt_s)), 1)
    kernel = np.ones(width) / width
    rate = np.gradient(base, window.blocks.time_s, axis=0)
    for j, ch in enumerate(OUTER_ROW):
        change = np.zeros_like(base)
        change[:, j] = -rate[:, j]
        add(f"lag {ch}", float(u_diff[CHANNELS.index(ch)]), change)
        add(f"split {ch}", SPLIT_SD_S, _other_split(window, disk, base[:, j], dt_s, j))
    for i, ch in enumerate(INNER_ROW):
        padded = np.pad(readings[:, INNER[i]], width, mode="edge")
        smooth = np.convolve(padded, kernel, mode="same")[width:-width]
        slope = np.gradient(smooth, dt_s)
        add(f"lag {ch}", float(u_diff[CHANNELS.index(ch)]), _through_boundary(window, slope, dt_s, gains, i))


def _other_split(
    window: DiskWindow, disk: DiskTraces, base: NDArray[np.float64], dt_s: float, j: int
) -> NDArray[np.float64]:
    """Change of outer reading j per second moved from its first lag to its second, their sum kept; (R, 3).

    (1 + tau1 s)(1 + tau2 s) grows by delta (tau1 - tau2) s^2, so the reading loses
    delta (tau1 - tau2) s^2 / ((1 + tau1 s)(1 + tau2 s)) of itself.
    """
    taus = sorted(disk.mean_chain.taus_s, reverse=True)
    tau1, tau2 = max(taus[0], 5e-3), max(taus[1] if len(taus) > 1 else 0.0, 2 * dt_s)
    whole = np.interp(window.time_s, window.blocks.time_s, base)
    b, a = discretised([tau1 - tau2, 0.0, 0.0], np.polymul([tau1, 1.0], [tau2, 1.0]), dt_s)
    lost = signal.lfilter(b, a, whole, zi=signal.lfilter_zi(b, a) * whole[0])[0]
    out = np.zeros((len(base), len(OUTER_ROW)))
    out[:, j] = -window.blocks.mean(lost)
    return out


def differential_lag_u_s(covariance_s2: NDArray[np.float64]) -> NDArray[np.float64]:
    """Standard uncertainty of each channel's lag less the mean of all, from their covariance; (M, M) -> (M,)."""
    return np.sqrt(np.clip(np.diag(with_common_u(covariance_s2, 0.0)), 0.0, None))


def with_common_u(covariance_s2: NDArray[np.float64], common_u_s: float) -> NDArray[np.float64]:
    """Covariance (M, M) of lags whose differences are known as ``covariance_s2`` says and their mean to ``common_u_s``.

    >>> with_common_u(np.full((2, 2), 0.25), 0.1).round(4)
    array([[0.01, 0.01],
           [0.01, 0.01]])
    """
    centre = np.eye(len(covariance_s2)) - 1.0 / len(covariance_s2)
    return np.asarray(centre @ covariance_s2 @ centre.T + common_u_s**2)
