"""``beta.json``: the contract with everybody's scripts (design, section 8)."""

from __future__ import annotations

from typing import Any

import numpy as np

from calibration.disk import DISKS
from calibration.estimate import Estimate
from calibration.grade import as_findings
from tcdyn.partition.analyse import Partition
from tcdyn.partition.crosscheck import Tension
from tcdyn.partition.profile_interval import profiles_file
from tcdyn.partition.sensors.depths import DepthTest

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
            "profiles": profiles_file(p.profiles),
        },
        "crosscheck": {
            "z": p.crosscheck.z,
            "agree": p.crosscheck.agree,
            "sentence": p.crosscheck.sentence,
            "p_value": p.crosscheck.p_value,
            "suspects": [_tension(t) for t in p.crosscheck.suspects],
            "strained": None if p.crosscheck.strained is None else _tension(p.crosscheck.strained),
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
        "junctions": {} if p.sensors is None else {d: _junctions(t) for d, t in p.sensors.depths.items()},
        "findings": [found.to_dict() for found in as_findings(p.warnings)],
        "warnings": list(p.warnings),
    }


def _tension(t: Tension) -> dict[str, Any]:
    return {"what": t.what, "z": t.z, "chance": t.chance}


def _junctions(t: DepthTest) -> dict[str, Any]:
    """How much deeper this test alone places each junction than rig.toml [mm], and its pull on the stated depth."""
    return {
        c: {"deeper_mm": Estimate.normal(1e3 * e.value, 1e3 * e.u).model_dump(), "z": float(z)}
        for (c, e), z in zip(t.deeper_m.items(), t.pull)
    }
