"""Coverage for disks plunged in oil and water, heated and cooled, with other published forms of
h(T) than the fit uses.

The simulator is independent of the fit: finite volumes (``plunge_simulator``), its own properties
of oil and water, and five forms of h(T). ``python tests/immersion/forms_study.py N SEED`` prints
coverage and findings of N disks with two plunges each.
"""

from __future__ import annotations

import sys
from collections import Counter
from collections.abc import Callable
from typing import Any

import numpy as np
from plunge_simulator import WIDTH, Draws, draw_pairs, simulate
from plunge_study import OWN_LAG_S, make_runs

from immersion.plunge_fit import identify_plunges, with_structure_uncertainty
from tcdyn.rig.disk import CHANNELS
from tcdyn.rig.rigfile import load_rig

DIAMETER = 0.0762
GRAVITY = 9.80665
Law = Callable[[np.ndarray, np.ndarray], np.ndarray]


def oil(T: np.ndarray) -> tuple[np.ndarray, ...]:
    """Mobil Jet Oil II: k, kinematic viscosity, diffusivity, expansion (Walther; MIL-L-23699
    bearing codes)."""
    nu = (10**10 ** (9.31259 - 3.66650 * np.log10(T + 273.15)) - 0.7) * 1e-6
    rho = 1003.5 - 0.7 * (T - 15)
    k = 0.14868 - 2.2275e-4 * (T + 273.15 - 366.67)
    return k, nu, k / (rho * 2000.0), 0.7 / rho


def water(T: np.ndarray) -> tuple[np.ndarray, ...]:
    """Water: k by Ramires and others (1995), viscosity by Vogel's law, density by McCutcheon
    (1993)."""
    x = (T + 273.15) / 298.15
    k = 0.6065 * (-1.48445 + 4.12292 * x - 1.63866 * x * x)

    def rho(t: np.ndarray) -> np.ndarray:
        return 1000 * (1 - (t + 288.9414) / (508929.2 * (t + 68.12963)) * (t - 3.9863) ** 2)

    nu = 2.414e-5 * 10 ** (247.8 / (T + 273.15 - 140)) / rho(T)
    return k, nu, k / (rho(T) * 4186.0), (rho(T - 0.1) - rho(T + 0.1)) / (0.2 * rho(T))


def rayleigh(
    p: tuple[np.ndarray, ...], wall: np.ndarray, bulk: np.ndarray, length: float
) -> np.ndarray:
    """Rayleigh number of a length, with properties ``p``."""
    return GRAVITY * p[3] * np.abs(bulk - wall) * length**3 / (p[1] * p[2])


def mcadams(fluid: Callable, wall: np.ndarray, bulk: np.ndarray) -> np.ndarray:
    """McAdams (1954), vertical, film temperature: 0.59 Ra^(1/4), from Ra = 1e9 on 0.13 Ra^(1/3)."""
    p = fluid((wall + bulk) / 2)
    ra = rayleigh(p, wall, bulk, WIDTH)
    return p[0] / WIDTH * np.where(ra < 1e9, 0.59 * ra**0.25, 0.13 * ra ** (1 / 3))


def mikheev(fluid: Callable, wall: np.ndarray, bulk: np.ndarray) -> np.ndarray:
    """Mikheev (1956), vertical, properties of the bulk: 0.76 Ra^(1/4) (Pr_bulk / Pr_wall)^(1/4)."""
    p = fluid(bulk)
    w = fluid(wall)
    return (
        p[0]
        / WIDTH
        * 0.76
        * rayleigh(p, wall, bulk, WIDTH) ** 0.25
        * (p[1] / p[2] / (w[1] / w[2])) ** 0.25
    )


def churchill(fluid: Callable, wall: np.ndarray, bulk: np.ndarray) -> np.ndarray:
    """Churchill and Chu (1975), plate at any Ra, film temperature."""
    p = fluid((wall + bulk) / 2)
    ra = rayleigh(p, wall, bulk, WIDTH) / (1 + (0.492 * p[2] / p[1]) ** (9 / 16)) ** (16 / 9)
    return p[0] / WIDTH * (0.825 + 0.387 * ra ** (1 / 6)) ** 2


def morgan(fluid: Callable, wall: np.ndarray, bulk: np.ndarray) -> np.ndarray:
    """Morgan (1975), horizontal cylinder, film temperature, a power for each range of Ra."""
    p = fluid((wall + bulk) / 2)
    ra = rayleigh(p, wall, bulk, DIAMETER)
    ends = (1e2, 1e4, 1e7)
    powers = ((1.02, 0.148), (0.850, 0.188), (0.480, 0.250), (0.125, 1 / 3))
    return p[0] / DIAMETER * np.choose(np.searchsorted(ends, ra), [c * ra**n for c, n in powers])


def vdi(fluid: Callable, wall: np.ndarray, bulk: np.ndarray) -> np.ndarray:
    """VDI Heat Atlas F2, horizontal cylinder over half its circumference, film temperature."""
    p = fluid((wall + bulk) / 2)
    length = np.pi * DIAMETER / 2
    ra = rayleigh(p, wall, bulk, length) / (1 + (0.559 * p[2] / p[1]) ** (9 / 16)) ** (16 / 9)
    return p[0] / length * (0.752 + 0.387 * ra ** (1 / 6)) ** 2


FORMS = (mcadams, mikheev, churchill, morgan, vdi)
BATHS = {  # fluid, temperatures of the disk and of the two baths [degC], seconds after entry
    "oil, heated": (oil, "mobil-jet-ii", 26.0, (110.0, 138.0), 140.0),
    "oil, cooled": (oil, "mobil-jet-ii", 120.0, (25.0, 40.0), 140.0),
    "water, heated": (water, "water", 22.0, (70.0, 90.0), 60.0),
    "water, cooled": (water, "water", 85.0, (15.0, 30.0), 60.0),
}


def simulated_plunges(
    case: str, disks: int, seed: int, lag_s: float | None = None
) -> tuple[Draws, list[int], list[Any]]:
    """True values, form of each disk, and runs of ``disks`` disks in one bath; the forms alternate.

    With ``lag_s`` the lags of the disks are this within 20 %, instead of sampled from 0.3 to 1 s.
    """
    rng = np.random.default_rng([seed, list(BATHS).index(case)])
    fluid, name, start, baths, after_s = BATHS[case]
    d = draw_pairs(rng, disks, baths)
    d.initial = d.initial - 26.0 + start
    if lag_s is not None:
        mean = (d.tau1 + d.tau2).mean(axis=1)
        scale = (lag_s * np.exp(np.repeat(0.2 * rng.standard_normal(disks), 2)) / mean)[:, None]
        d.tau1 = scale * d.tau1
        d.tau2 = scale * d.tau2
    chosen = np.repeat(np.arange(disks) % len(FORMS), 2)

    def h_of(wall: np.ndarray, bulk: np.ndarray) -> np.ndarray:
        return np.choose(chosen, [form(fluid, wall, bulk) for form in FORMS])

    times, readings = simulate(d, after_s, rng, h_of=h_of)
    return d, chosen[::2].tolist(), make_runs(d, times, readings, rng, fluid_name=name)


def study(
    case: str, disks: int, seed: int, structures: bool = False, **options: Any
) -> list[dict[str, Any]]:
    """One row for each disk: form, errors and u of common lag and differences (6,), codes and kinds
    of findings."""
    d, chosen, runs = simulated_plunges(case, disks, seed)
    setup = load_rig().disk_setup("fast")
    rows = []
    for k, form in enumerate(chosen):
        fit = identify_plunges(runs[2 * k : 2 * k + 2], setup, **options)
        fit = with_structure_uncertainty(fit) if structures else fit
        true_lags = d.tau1[2 * k] + d.tau2[2 * k] + OWN_LAG_S
        differential = fit.differential_lag_s
        common = fit.common_lag_s
        rows.append(
            {
                "case": case,
                "form": FORMS[form].__name__,
                "common": common.value - true_lags.mean(),
                "u_common": common.u,
                "common_covered": common.contains(true_lags.mean()),
                "differential": np.array([differential[c].value for c in CHANNELS])
                - (true_lags - true_lags.mean()),
                "u_differential": np.array([differential[c].u for c in CHANNELS]),
                "warnings": [
                    (f.code, f.numbers.get("kind", ""))
                    for f in fit.findings
                    if f.severity == "warning"
                ],
            }
        )
    return rows


def summary_line(rows: list[dict[str, Any]]) -> str:
    """Coverage in percent, errors, u and findings, in one line."""
    z = np.array([r["differential"] / r["u_differential"] for r in rows])
    common = np.array([r["common"] for r in rows])
    plunge_codes = ("plunge.pull", "plunge.fluid")
    warnings = [{w for w in r["warnings"] if w[0] in plunge_codes} for r in rows]
    counts = dict(Counter(kind or code for found in warnings for code, kind in found))
    mean = " ".join(f"{m:+.0f}" for m in 1e3 * np.mean([r["differential"] for r in rows], axis=0))
    u_differential, u_common = (
        np.sqrt(np.mean([r[k] ** 2 for r in rows])) for k in ("u_differential", "u_common")
    )
    covered = [r["common_covered"] for r in rows]
    return (
        f"{len(rows):4d} disks: differences covered {100 * np.mean(np.abs(z) < 1.96):.0f} %, rms z "
        f"{np.sqrt(np.mean(z**2)):.2f}, rms u {1e3 * u_differential:.1f} ms, mean error a .. f "
        f"[ms] {mean}; common covered {100 * np.mean(covered):.0f} %, error "
        f"{np.mean(common):+.3f} +- {np.std(common):.3f} s, u {u_common:.3f}; warnings of "
        f"deviating priors on {100 * np.mean([bool(found) for found in warnings]):.0f} % "
        f"{counts or ''}"
    )


def main(disks: int, seed: int, structures: bool = False) -> None:
    """A line for each bath and each form, and one for all."""
    rows: list[dict[str, Any]] = []
    for case in BATHS:
        case_rows = study(case, disks // len(BATHS), seed, structures)
        print(f"{case:14}", summary_line(case_rows), flush=True)
        rows += case_rows
    for form in sorted({r["form"] for r in rows}):
        print(f"{form:14}", summary_line([r for r in rows if r["form"] == form]))
    print(f"{'all':14}", summary_line(rows))


if __name__ == "__main__":
    main(int(sys.argv[1]), int(sys.argv[2]), "structures" in sys.argv)
