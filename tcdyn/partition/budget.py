"""Where the uncertainty of beta comes from: Monte Carlo by source over both ways and both disks (GUM Supplement 1)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tcdyn.partition.shift import FitShift
from tcdyn.partition.steady import Line, speed_law_beta

DRAWS = 4000
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
    draws: dict[str, NDArray[np.float64]]

    @property
    def together(self) -> tuple[float, float]:
        """Standard uncertainty of beta by the speed law, and by the cooling fit of the worse disk, of all sources."""
        cooling = [float(np.std(self.draws[f"cooling {d}"])) for d in ("fast", "slow")]
        return float(np.std(self.draws["speed law"])), max(cooling)


def source_of(nuisance: str) -> str:
    """The line of the budget that a nuisance belongs to.

    >>> source_of("depth e"), source_of("static b"), source_of("washer")
    ('junction depth', 'static lines', 'washer')
    """
    head = nuisance.split()[0]
    return {
        "depth": "junction depth",
        "static": "static lines",
        "lag": "chain",
        "split": "chain",
        "common": "chain",
        "heat": "heat capacity",
        "model": "rim model form",
    }.get(head, nuisance)


def monte_carlo(
    lines: Mapping[str, Line],
    shifts: Mapping[str, FitShift],
    cooling: Mapping[str, tuple[float, float]],
    cooling_shifts: Mapping[str, FitShift],
    cooling_by_lag: Mapping[str, NDArray[np.float64]],
    joint: Mapping[str, tuple[float, float]],
    joint_shifts: Mapping[str, FitShift],
    speed_ratio: float,
    exponent: float,
    exponent_range: tuple[float, float],
    seed: int = 0,
    draws: int = DRAWS,
) -> Budget:
    """Draw all sources, push them through lines, speed law and transient fits, and read off each source's part.

    ``lines``: steady line of "fast" and "slow"; ``cooling`` and ``joint``: (share, h) of each disk. Shared nuisances
    move both disks together. The exponent n is drawn evenly from its range; everything else is normal.
    """
    names = sorted({(d if not sh else "both", n) for d, s in shifts.items() for n, sh in zip(s.names, s.shared)})
    names += [(d, own) for d in ("fast", "slow") for own in ("common lag", "lag shape", "model form")]
    rng = np.random.default_rng(seed)
    normal = {key: rng.standard_normal(draws) for key in names}
    uniform = rng.uniform(*exponent_range, draws)
    noise = {d: rng.standard_normal((draws, 7)) for d in ("fast", "slow")}

    def run(active: str | None) -> dict[str, NDArray[np.float64]]:
        n = uniform if active in (None, "speed exponent") else np.full(draws, exponent)
        moved: dict[str, NDArray[np.float64]] = {}
        coefficient = {}
        for d in ("fast", "slow"):
            change = _errors(shifts[d], d, active, normal, noise[d][:, :2])
            line = lines[d]
            coefficient[d] = (line.intercept + change[:, 0], line.slope + change[:, 1])
            grow = 1 + MODEL_FORM_REL * normal[(d, "model form")]
            if active in (None, "rim model form"):
                coefficient[d] = (coefficient[d][0] * grow, coefficient[d][1] * grow)
            off = _errors(joint_shifts[d], d, active, normal, noise[d][:, 4:])
            late = off[:, 2:] * cooling_by_lag[d]
            cool = _errors(cooling_shifts[d], d, active, normal, noise[d][:, 2:4]) + late
            for kind, centre, value in (("cooling", cooling[d], cool), ("joint", joint[d], off)):
                grown = centre[0] * (grow - 1.0) if active in (None, "rim model form") else 0.0
                share = centre[0] + value[:, 0] + grown
                moved[f"{kind} {d}"] = share if d == "fast" else 1 - share
                moved[f"h {kind} {d}"] = centre[1] + value[:, 1]
            moved[f"lag {d}"] = off[:, 2]
        (a, b), (c, dd) = coefficient["fast"], coefficient["slow"]
        moved["speed law"] = np.asarray(speed_law_beta(a, b, c, dd, speed_ratio**n))  # type: ignore[arg-type]
        moved["h_fast"] = (moved["speed law"] - a) / b
        moved["h_slow"] = (1 - moved["speed law"] - c) / dd
        moved["exponent"] = n
        moved["fast intercept"], moved["fast slope"], moved["slow intercept"], moved["slow slope"] = a, b, c, dd
        return moved

    everything = run(None)
    sources = sorted({source_of(n) for _, n in names} | {"speed exponent", "noise", "rim model form"})
    rows = []
    for source in sources:
        one = run(source)
        transient = [float(np.std(one[f"cooling {d}"])) for d in ("fast", "slow") if f"cooling {d}" in one]
        rows.append(BudgetRow(source, float(np.std(one["speed law"])), max(transient, default=0.0)))
    rows.sort(key=lambda r: -max(r.u_beta_steady, r.u_beta_transient))
    return Budget(tuple(rows), everything)


def _errors(
    shift: FitShift,
    disk: str,
    active: str | None,
    normal: Mapping[tuple[str, str], NDArray[np.float64]],
    noise: NDArray[np.float64],
) -> NDArray[np.float64]:
    """Drawn errors (draws, k) of one fit, of all sources or of the ``active`` one."""
    out = np.zeros((len(noise), shift.per_sd.shape[1]))
    for q, (name, shared) in enumerate(zip(shift.names, shift.shared)):
        if active in (None, source_of(name)):
            out += normal[("both" if shared else disk, name)][:, None] * shift.per_sd[q]
    if active in (None, "noise"):
        out += noise @ _root(shift.noise).T
    return out


def _root(covariance: NDArray[np.float64]) -> NDArray[np.float64]:
    """A square root of a covariance that may be singular."""
    values, vectors = np.linalg.eigh(covariance)
    return np.asarray(vectors * np.sqrt(np.clip(values, 0.0, None)))
