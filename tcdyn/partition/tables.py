"""The answers of one test as tables for people: ways to beta, budget, conditions."""

from __future__ import annotations

import pandas as pd

from calibration.disk import DISKS
from tcdyn.partition.analyse import Partition


def ways_table(p: Partition) -> pd.DataFrame:
    """beta, h and lag by every way, with standard uncertainties."""
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
        b, hh = p.estimate(key, beta), p.estimate(h_key, h)
        table.append(
            {
                "way": word,
                "β [1]": f"{b.value:.4f} ± {b.u:.4f}",
                "h [W/m²K]": f"{hh.value:.0f} ± {hh.u:.0f}",
                "lag [s]": f"{lag.value:.3f} ± {lag.u:.3f}" if lag else "",
            }
        )
    both = p.both.estimates
    table.append(
        {
            "way": "joint fit, both disks",
            "β [1]": f"{both['beta'].value:.4f} ± {both['beta'].u:.4f}",
            "h [W/m²K]": f"{both['h_fast'].value:.0f} / {both['h_slow'].value:.0f}",
            "lag [s]": f"n = {both['exponent'].value:.3f} ± {both['exponent'].u:.3f}",
        }
    )
    return pd.DataFrame(table)


def budget_table(p: Partition) -> pd.DataFrame:
    """Source, and its standard uncertainty of beta by the speed law and by the cooling fit."""
    return pd.DataFrame(
        [
            {
                "source": r.source,
                "u(β) speed law": f"{r.u_beta_steady:.4f}",
                "u(β) cooling fit, worse disk": f"{r.u_beta_transient:.4f}",
            }
            for r in p.budget.rows
        ]
    )


def test_table(p: Partition) -> pd.DataFrame:
    """The test's conditions."""
    t = p.test
    rows = [
        ("load", t.load_N, "N"),
        ("friction", t.friction_N, "N"),
        ("friction coefficient", t.friction_N / t.load_N, "1"),
        ("sliding speed", t.sliding_speed_m_s, "m/s"),
        ("entraining speed", t.entraining_speed_m_s, "m/s"),
        ("half-width of the contact", t.half_width_m * 1e3, "mm"),
        ("load on", t.events.load_on_s, "s"),
        ("unloading", t.events.unload_s, "s"),
        ("hottest surface, fast", p.surface.fast_max_degC, "°C"),
        ("hottest surface, slow", p.surface.slow_max_degC, "°C"),
        ("ΔT u_s", p.surface.delta_T_us, "K m/s"),
    ]
    return pd.DataFrame([{"quantity": q, "value": f"{v:.4g}", "unit": unit} for q, v, unit in rows])
