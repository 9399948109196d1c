"""The answers of one test as tables for people: ways to beta, budget, conditions."""

from __future__ import annotations

from collections.abc import Mapping

import pandas as pd

from calibration.disk import DISKS
from calibration.estimate import Estimate, rounded, with_u
from tcdyn.partition.analyse import Partition
from tcdyn.partition.sensors.depths import DepthTest


def ways_table(p: Partition) -> pd.DataFrame:
    """beta, h, lag and exponent by every way: standard uncertainties, and beta's 95 % interval."""
    rows: list[tuple[str, float, str, float, str, str | None]] = [
        ("speed law, fast disk", p.speed.beta, "speed law", p.speed.h_fast, "h_fast", None),
        ("speed law, slow disk", p.speed.beta, "speed law", p.speed.h_slow, "h_slow", None),
    ]
    for d in DISKS:
        cool = p.cooling[d]
        rows.append((f"cooling fit, {d} disk", cool.beta, f"cooling {d}", cool.h_W_m2K, f"h cooling {d}", None))
    for d in DISKS:
        joint = p.joint[d]
        rows.append((f"joint fit, {d} disk", joint.beta, f"joint {d}", joint.h_W_m2K, f"h joint {d}", d))
    table = []
    for word, beta, key, h, h_key, disk in rows:
        lag = p.joint[disk].estimates["lag_s"] if disk else None
        hh = p.estimate(h_key, h)
        row = _way(word, p.estimate(key, beta), with_u(hh.value, hh.u))
        table.append({**row, "lag [s]": with_u(lag.value, lag.u) if lag else "", "exponent n [1]": ""})
    both = p.both.estimates
    for d in DISKS:
        h_both, n = both[f"h_{d}"], both["exponent"]
        row = _way(f"joint fit of both, {d} disk", both["beta"], with_u(h_both.value, h_both.u))
        table.append({**row, "lag [s]": "", "exponent n [1]": with_u(n.value, n.u)})
    return pd.DataFrame(table)


def _way(word: str, beta: Estimate, h: str) -> dict[str, str]:
    low, high = (rounded(end, beta.u)[0] for end in (beta.low95, beta.high95))
    return {"way": word, "β [1]": with_u(beta.value, beta.u), "95 % of β": f"{low} to {high}", "h [W/m²K]": h}


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
