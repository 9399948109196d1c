"""The answers of one test as tables: ways to beta, budget, conditions, and how far the cooling fit can be trusted."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import pandas as pd

from calibration.disk import DISKS
from calibration.errors import InputError
from calibration.estimate import Estimate, rounded, with_u
from calibration.words import as_known
from tcdyn.partition.analyse import Partition
from tcdyn.partition.cooling import compensated, cooling_fit
from tcdyn.partition.faults import DepthTest
from tcdyn.partition.profile import intervals
from tcdyn.partition.window import stretch_of

HEADINGS = {
    "beta": "β [1]",
    "h": "h [W/m²K]",
    "lag_s": "lag [s]",
    "h_fast": "h, fast [W/m²K]",
    "h_slow": "h, slow [W/m²K]",
    "exponent": "exponent n [1]",
}
LENGTHS_S = (0.5, 0.75, 1.0, 1.5, 2.0, 3.0, 5.0, 7.5, 10.0, 15.0, 20.0)
TWO_SIGMA = 2.0


def ways_table(p: Partition) -> pd.DataFrame:
    """beta, h, lag and exponent by every way: standard uncertainties, and beta's 95 % interval."""
    table = []

    def way(word: str, beta: Estimate, h: Estimate, lag: Estimate | None = None, n: Estimate | None = None) -> None:
        low, high = (rounded(end, beta.u)[0] for end in (beta.low95, beta.high95))
        row = {"way": word, "β [1]": with_u(beta.value, beta.u), "95 % of β": f"{low} to {high}"}
        more = {"h [W/m²K]": h, "lag [s]": lag, "exponent n [1]": n}
        table.append(row | {key: with_u(e.value, e.u) if e else "" for key, e in more.items()})

    for d, h in zip(DISKS, (p.speed.h_fast, p.speed.h_slow)):
        way(f"speed law, {d} disk", p.estimate("speed law", p.speed.beta), p.estimate(f"h_{d}", h))
    for kind, fits in (("cooling", p.cooling), ("joint", p.joint)):
        for d, fit in fits.items():
            beta, h_fit = p.estimate(f"{kind} {d}", fit.beta), p.estimate(f"h {kind} {d}", fit.h_W_m2K)
            way(f"{kind} fit, {d} disk", beta, h_fit, p.joint[d].estimates["lag_s"] if kind == "joint" else None)
    both = p.both.estimates
    for d in DISKS:
        way(f"joint fit of both, {d} disk", both["beta"], both[f"h_{d}"], n=both["exponent"])
    return pd.DataFrame(table)


def budget_table(p: Partition) -> pd.DataFrame:
    """Source, and its standard uncertainty of beta by the speed law and by the cooling fit; last, all together."""
    speed, cooling = p.budget.together
    rows = [(r.source, r.u_beta_steady, r.u_beta_transient) for r in p.budget.rows]
    return pd.DataFrame(
        [
            {"source": source, "u(β) [1], speed law": _u(a), "u(β) [1], cooling fit of the worse disk": _u(b)}
            for source, a, b in [*rows, ("all together", speed, cooling)]
        ]
    )


def _u(u: float) -> str:
    return f"{u:.4f}" if u >= 0.00005 else "below 0.0001"


def test_table(p: Partition) -> pd.DataFrame:
    """The test's conditions."""
    t = p.test
    drawn = {
        "hottest surface, fast disk": ("surface fast", p.surface.fast_max_degC, "°C"),
        "hottest surface, slow disk": ("surface slow", p.surface.slow_max_degC, "°C"),
        "their difference times sliding speed, ΔT u_s": ("delta_T_us", p.surface.delta_T_us, "K m/s"),
    }
    parting = with_u(t.events.unload_s, t.events.unload_u_s)
    plain = [
        ("load", f"{t.load_N:.0f}", "N"),
        ("friction", f"{t.friction_N:.2f}", "N"),
        ("friction coefficient", f"{t.friction_N / t.load_N:.4f}", "1"),
        ("sliding speed", f"{t.sliding_speed_m_s:.2f}", "m/s"),
        ("entraining speed", f"{t.entraining_speed_m_s:.2f}", "m/s"),
        ("half-width of the contact", f"{t.half_width_m * 1e3:.3f}", "mm"),
        ("load on at", f"{t.events.load_on_s:.2f}", "s"),
        ("unloading at", parting, "s"),
    ]
    for word, (key, value, unit) in drawn.items():
        estimate = p.estimate(key, value)
        plain.append((word, with_u(estimate.value, estimate.u), unit))
    return pd.DataFrame(plain, columns=["quantity", "value", "unit"])


def junctions_table(tests: Mapping[str, DepthTest]) -> pd.DataFrame:
    """How much deeper than stated each junction lies by the test alone, and its pull on what is stated."""
    rows = []
    for disk, test in tests.items():
        for (channel, deeper), pull in zip(test.deeper_m.items(), test.pull):
            mm = with_u(1e3 * deeper.value, 1e3 * deeper.u)
            rows.append((disk, channel, mm, f"{1e3 * test.stated_u_m:.2f}", f"{round(float(pull), 1) + 0.0:+.1f}"))
    columns = [
        "disk",
        "junction",
        "deeper than stated [mm]",
        "u of the stated depth [mm]",
        "standard deviations off [1]",
    ]
    return pd.DataFrame(rows, columns=columns)


def cooling_by_window(partition: Partition, lengths: Sequence[float] = LENGTHS_S) -> pd.DataFrame:
    """The h-only fit of both disks for each window length [s]: disk, window_s, beta, u_beta, h, u_h, misfit, lag.

    ``u_beta`` and ``u_h_W_m2K`` hold noise, nuisances, the steady line and the lag, as the budget
    does; ``within_lag`` marks windows shorter than the disk's common lag, which hold more of the chain than of the
    cooling. Lengths beyond the log's end are left out; a window whose fit runs away has NaN. Raises InputError when no
    length is left, or one is not above zero.
    """
    test = partition.test
    held = float(test.time_s[-1] - test.events.unload_s)
    if min(lengths, default=1.0) <= 0:
        raise InputError(f"a window of {min(lengths):g} s", expected="lengths above zero")
    wanted = sorted(float(x) for x in lengths if x <= held)
    if not wanted:
        raise InputError(f"the log holds {held:.2f} s of cooling", expected=f"at least {min(lengths, default=0):g} s")
    rows = stretch_of(test, wanted[-1])
    return pd.DataFrame([row for d in DISKS for row in _disk_rows(partition, d, rows, wanted)])


def _disk_rows(p: Partition, name: str, rows: slice, lengths: Sequence[float]) -> list[dict[str, object]]:
    test, line, lag, at = p.test, p.lines[name], p.joint[name].estimates["lag_s"], p.cooling[name]
    cooled = compensated(test, test.disks[name], rows, p.chains[name], lag.u, p.windows[name].rim.profile)
    errors = cooled.errors(at.share, at.h_W_m2K)
    out: list[dict[str, object]] = []
    for length in lengths:
        row: dict[str, object] = {"disk": name, "window_s": length, "within_lag": length < lag.value}
        try:
            fit = cooling_fit(cooled.window, line.line, test.events.unload_s, length, cooled.noise_K)
        except InputError:
            empty = dict.fromkeys(("beta", "u_beta", "h_W_m2K", "u_h_W_m2K", "misfit_K"), np.nan)
            out.append(row | empty)
            continue
        shift = fit.shift(errors, line)
        u_share, u_h = np.sqrt((shift.per_sd**2).sum(axis=0) + np.diag(shift.noise) + (lag.u * shift.by_lag) ** 2)
        out.append(
            row
            | {
                "beta": fit.beta,
                "u_beta": float(u_share),
                "h_W_m2K": fit.h_W_m2K,
                "u_h_W_m2K": float(u_h),
                "misfit_K": fit.misfit_K,
            }
        )
    return out


def referee_table(partition: Partition) -> pd.DataFrame:
    """Compensated (cooling fit) against commuted (joint fit, no inverse) for beta and h of each disk.

    ``u_difference`` is the spread of the difference of the budget's draws, so that what moves both alike does not
    count; ``z`` = difference / u_difference; ``agree`` below two.
    """
    rows = []
    draws = partition.budget.draws
    for d in DISKS:
        cooling, joint = partition.cooling[d], partition.joint[d]
        for quantity, one, other, key in (
            ("beta", cooling.beta, joint.beta, ""),
            ("h_W_m2K", cooling.h_W_m2K, joint.h_W_m2K, "h "),
        ):
            a, b = draws[f"{key}cooling {d}"], draws[f"{key}joint {d}"]
            u = float(np.std(a - b))
            z = (one - other) / max(u, 1e-12)
            rows.append(
                {
                    "disk": d,
                    "quantity": quantity,
                    "compensated": one,
                    "u_compensated": float(np.std(a)),
                    "commuted": other,
                    "u_commuted": float(np.std(b)),
                    "difference": one - other,
                    "u_difference": u,
                    "correlation": float(np.corrcoef(a, b)[0, 1]),
                    "z": z,
                    "agree": bool(abs(z) < TWO_SIGMA),
                }
            )
    return pd.DataFrame(rows)


def interval_table(profiles: pd.DataFrame) -> pd.DataFrame:
    """Every number of the joint fits with both intervals, and a sentence where they part."""
    rows = []
    for i in intervals(profiles):
        e = i.estimate
        rows.append(
            {
                "joint fit": "both disks" if i.fit == "both" else f"{i.fit} disk",
                "number": HEADINGS[i.parameter],
                "value": str(e),
                "95 %, normal": " … ".join(as_known(end, e.u) for end in (e.low95, e.high95)),
                "95 %, profile": " … ".join(as_known(end, e.u) for end in (i.low95, i.high95)),
                "remark": i.sentence,
            }
        )
    return pd.DataFrame(rows)
