"""``beta.json``: the contract with everybody's scripts (design, section 8)."""

from __future__ import annotations

from typing import Any

import numpy as np

from calibration.disk import DISKS
from calibration.estimate import Estimate
from tcdyn.partition.analyse import Partition

SCHEMA = "tcdyn.beta/1"


def beta_file(p: Partition, source: dict[str, str]) -> dict[str, Any]:
    """The content of ``beta.json``; every estimate is {value, u, low95, high95}, h in W/m2K, lags in s."""
    test, draws = p.test, p.budget.draws

    def est(key: str, value: float) -> dict[str, float]:
        return Estimate.normal(value, float(np.std(draws[key]))).model_dump()

    lines = {d: p.lines[d].line for d in DISKS}
    spread = float(np.std(draws["exponent"]))
    return {
        "schema": SCHEMA,
        "source": source,
        "test": {
            "load_N": test.load_N,
            "friction_N": test.friction_N,
            "sliding_speed_m_s": test.sliding_speed_m_s,
            "entraining_speed_m_s": test.entraining_speed_m_s,
            "half_width_m": test.half_width_m,
            "load_on_s": test.events.load_on_s,
            "unload_s": test.events.unload_s,
        },
        "steady": {
            "beta": est("speed law", p.speed.beta),
            "h_fast": est("h_fast", p.speed.h_fast),
            "h_slow": est("h_slow", p.speed.h_slow),
            **{
                f"{d}_line": {
                    "intercept": est(f"{d} intercept", lines[d].intercept),
                    "slope": est(f"{d} slope", lines[d].slope),
                }
                for d in DISKS
            },
            "exponent": Estimate.normal(test.speed_exponent, spread).model_dump(),
        },
        "transient": {
            d: {
                "beta": est(f"cooling {d}", p.cooling[d].beta),
                "h": est(f"h cooling {d}", p.cooling[d].h_W_m2K),
                "window_s": p.cooling[d].window_s,
            }
            for d in DISKS
        },
        "joint": {
            **{
                d: {
                    "beta": est(f"joint {d}", p.joint[d].beta),
                    "h": est(f"h joint {d}", p.joint[d].h_W_m2K),
                    "lag_s": p.joint[d].estimates["lag_s"].model_dump(),
                }
                for d in DISKS
            },
            "both": {k: v.model_dump() for k, v in p.both.estimates.items()},
        },
        "crosscheck": {
            "z": p.crosscheck.z,
            "agree": p.crosscheck.agree,
            "sentence": p.crosscheck.sentence,
            "p_value": p.crosscheck.p_value,
            "suspects": [{"what": t.what, "z": t.z} for t in p.crosscheck.suspects],
            "strained": None
            if p.crosscheck.strained is None
            else {"what": p.crosscheck.strained.what, "z": p.crosscheck.strained.z},
            "pairs": [{"one": a, "other": b, "difference": gap, "z": z} for a, b, gap, z in p.crosscheck.pairs],
        },
        "budget": [
            {
                "source": row.source,
                "u_beta_steady": row.u_beta_steady,
                "u_beta_transient": row.u_beta_transient,
            }
            for row in p.budget.rows
        ],
        "surface": {
            "fast_max_degC": est("surface fast", p.surface.fast_max_degC),
            "slow_max_degC": est("surface slow", p.surface.slow_max_degC),
            "delta_T_us": est("delta_T_us", p.surface.delta_T_us),
        },
        "sensors": {} if p.sensors is None else dict(p.sensors.verdicts),
        "warnings": list(p.warnings),
    }
