"""Where the uncertainty of beta comes from: Monte Carlo by source over both ways and both disks (GUM Supplement 1)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from calibration.disk import DISKS
from tcdyn.partition.cooling import CoolingFit, CoolingShift
from tcdyn.partition.effects import FitShift, Unmeasured
from tcdyn.partition.joint import DiskFit
from tcdyn.partition.prepare import EhlTest
from tcdyn.partition.steady import DiskLine, SpeedLawPoint, speed_law_beta
from tcdyn.partition.window import DiskWindow

Array = NDArray[np.float64]
DRAWS = 4000
LAST_S = 10.0
SURFACE_DEPTH_M = 0.0
MODEL_FORM_REL = 0.002  # of the share: inner profile and mesh; 0.03 % was seen against the whole disk, symmetric


@dataclass(frozen=True)
class BudgetRow:
    """One source of uncertainty and its standard uncertainty of beta by the speed law and by the cooling fit."""

    source: str
    u_beta_steady: float
    u_beta_transient: float


@dataclass(frozen=True)
class Budget:
    """``rows`` by source; ``draws`` of every quantity, all sources together, each (draws,)."""

    rows: tuple[BudgetRow, ...]
    draws: dict[str, Array]

    @property
    def together(self) -> tuple[float, float]:
        """Standard uncertainty of beta by the speed law, and by the cooling fit of the worse disk, of all sources."""
        cooling = [float(np.std(self.draws[f"cooling {d}"])) for d in DISKS]
        return float(np.std(self.draws["speed law"])), max(cooling)


def monte_carlo(
    test: EhlTest,
    lines: Mapping[str, DiskLine],
    cooling: Mapping[str, CoolingFit],
    cooling_shifts: Mapping[str, CoolingShift],
    joint: Mapping[str, DiskFit],
    seed: int = 0,
) -> Budget:
    """Draw all sources, push them through lines, speed law and transient fits, and read off each source's part.

    What both disks share moves both together. The exponent n is drawn evenly from its range; everything else is normal.
    """
    names = sorted({_key(what, d) for d in DISKS for what in lines[d].shift.of})
    names += [(d, own) for d in DISKS for own in ("common lag", "lag shape", "model form")]
    rng = np.random.default_rng(seed)
    normal = {key: rng.standard_normal(DRAWS) for key in names}
    uniform = rng.uniform(*test.exponent_range, DRAWS)
    noise = {d: rng.standard_normal((DRAWS, 7)) for d in DISKS}

    def run(active: str | None) -> dict[str, Array]:
        moved = {"exponent": uniform if active in (None, "speed exponent") else np.full(DRAWS, test.speed_exponent)}
        for d in DISKS:
            line, form = lines[d].line, active in (None, "rim model form")
            grow = 1 + MODEL_FORM_REL * normal[d, "model form"] * form
            change = _errors(lines[d].shift, d, active, normal, noise[d][:, :2])
            moved[f"{d} intercept"] = (line.intercept + change[:, 0]) * grow
            moved[f"{d} slope"] = (line.slope + change[:, 1]) * grow
            off = _errors(joint[d].shift, d, active, normal, noise[d][:, 4:])
            cool = _errors(cooling_shifts[d], d, active, normal, noise[d][:, 2:4])
            cool += off[:, 2:] * cooling_shifts[d].by_lag
            for way, at, error in (("cooling", cooling[d], cool), ("joint", joint[d], off)):
                share = at.share * grow + error[:, 0]
                moved[f"{way} {d}"] = share if d == "fast" else 1 - share
                moved[f"h {way} {d}"] = at.h_W_m2K + error[:, 1]
            moved[f"lag {d}"] = off[:, 2]
        a, b, c, slope = (moved[f"{d} {key}"] for d in DISKS for key in ("intercept", "slope"))
        beta = moved["speed law"] = np.asarray(speed_law_beta(a, b, c, slope, test.speed_ratio ** moved["exponent"]))
        return moved | {"h_fast": (beta - a) / b, "h_slow": (1 - beta - c) / slope}

    known = {what.source for d in DISKS for shift in (lines[d].shift, joint[d].shift) for what in shift.of}
    rows = []
    for source in sorted(known | {"speed exponent", "noise", "rim model form"}):
        one = run(source)
        transient = max(float(np.std(one[f"cooling {d}"])) for d in DISKS)
        rows.append(BudgetRow(source, float(np.std(one["speed law"])), transient))
    rows.sort(key=lambda r: -max(r.u_beta_steady, r.u_beta_transient))
    return Budget(tuple(rows), run(None))


def _errors(
    shift: FitShift,
    disk: str,
    active: str | None,
    normal: Mapping[tuple[str, str], Array],
    noise: Array,
) -> Array:
    """Drawn errors (draws, k) of one fit, of all sources or of the ``active`` one."""
    out = np.zeros((len(noise), shift.per_sd.shape[1]))
    for what, per_sd in zip(shift.of, shift.per_sd):
        if active in (None, what.source):
            out += normal[_key(what, disk)][:, None] * per_sd
    if active in (None, "noise"):
        out += noise @ _root(shift.noise).T
    return out


def _key(what: Unmeasured, disk: str) -> tuple[str, str]:
    """Whose draw it is: that of both disks, or of one."""
    return "both" if what.shared else disk, what.name


def _root(covariance: Array) -> Array:
    """A square root of a covariance that may be singular."""
    values, vectors = np.linalg.eigh(covariance)
    return np.asarray(vectors * np.sqrt(np.clip(values, 0.0, None)))


@dataclass(frozen=True)
class SurfaceMaxima:
    """Maximum of the running track's mean temperature [degC] and (T_fast - T_slow) u_s [K m/s] (figure 7.18).

    ``slopes``: of each disk's maximum by share [K] and by h [K per W/m2K], for the budget.
    """

    fast_max_degC: float
    slow_max_degC: float
    delta_T_us: float
    slopes: Mapping[str, tuple[float, float]]

    def draws(self, speed: SpeedLawPoint, drawn: Mapping[str, Array], sliding_m_s: float) -> dict[str, Array]:
        """Monte Carlo draws of the three numbers, from those of beta, h_fast and h_slow."""
        hottest = []
        for d, sign, at, h in (
            ("fast", 1, self.fast_max_degC, speed.h_fast),
            ("slow", -1, self.slow_max_degC, speed.h_slow),
        ):
            by_share, by_h = self.slopes[d]
            more = sign * by_share * (drawn["speed law"] - speed.beta) + by_h * (drawn[f"h_{d}"] - h)
            hottest.append(at + more)
        fast, slow = hottest
        return {"surface fast": fast, "surface slow": slow, "delta_T_us": (fast - slow) * sliding_m_s}


def surface_temperatures(test: EhlTest, speed: SpeedLawPoint, windows: Mapping[str, DiskWindow]) -> SurfaceMaxima:
    """Surface maxima over the last seconds under load; the centre of the track is the hottest place."""
    found, slopes = {}, {}
    for disk, h, share in (("fast", speed.h_fast, speed.beta), ("slow", speed.h_slow, 1 - speed.beta)):
        last = windows[disk].between(test.events.unload_s - LAST_S, test.events.unload_s - 0.2)
        rest, power = _track(windows[disk], max(h, 0.0), last)
        hottest = int(np.argmax(rest + share * power))
        step = 0.01 * max(h, 10.0)
        rest_up, power_up = _track(windows[disk], max(h, 0.0) + step, last)
        found[disk] = float(rest[hottest] + share * power[hottest])
        moved = float(rest_up[hottest] + share * power_up[hottest])
        slopes[disk] = (float(power[hottest]), (moved - found[disk]) / step)
    return SurfaceMaxima(found["fast"], found["slow"], (found["fast"] - found["slow"]) * test.sliding_speed_m_s, slopes)


def _track(window: DiskWindow, h: float, last: NDArray[np.bool_]) -> tuple[Array, Array]:
    """Mean surface temperature without heat and per share at nine places across the track."""
    extra = tuple((SURFACE_DEPTH_M, float(x)) for x in np.linspace(0.3, 0.7, 9) * window.rim.setup.width_m)
    rest, power = window.rim.answer(h, extra=extra)
    return rest[last, 3:].mean(axis=0), power[last, 3:].mean(axis=0)
