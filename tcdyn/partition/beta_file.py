"""The content of beta.json.

The keys are read by other programs and by ``tcdyn.campaign.summary_table``: a new one is described
in docs/files.md, and a test compares them.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict
from typing import Any

from tcdyn.core.estimate import Estimate
from tcdyn.partition.analyse import Partition
from tcdyn.partition.joint_results import joint_budget
from tcdyn.partition.profile import profiles_file
from tcdyn.partition.sensor_check import SensorCheck

SCHEMA = "tcdyn.beta/1"  # of beta.json; it changes with the meaning of a key
# an estimate that is withheld
WITHHELD: dict[str, Any] = dict.fromkeys(("value", "u", "low95", "high95"))


def beta_file(p: Partition, source: dict[str, str], with_profiles: bool = False) -> dict[str, Any]:
    """The content of ``beta.json`` without sufficient statistics and checksum.

    Parameters
    ----------
    p
        The partition.
    source
        Name and SHA-256 of the log.
    with_profiles
        Whether to compute the likelihood profiles of the joint fits; otherwise ``profiles`` is
        empty.

    Returns
    -------
    dict
        Every estimate is {value, u, low95, high95}, null where it is withheld or needs a disk that
        was not logged; h in W/m2K, lags in s, depths of junctions in mm.

    Notes
    -----
    ``SCHEMA`` changes with the meaning of a key. ``tcdyn.campaign.summary_table.COLUMNS`` uses
    the same keys.
    """
    test = p.test
    forms = p.model_forms
    is_withheld = p.status == "withheld"
    recommended = joint_budget(p)
    recommended_beta = _reported(p, p.combined.estimates, "beta", "both ")
    range95 = None
    alternatives = []
    if forms is not None and not is_withheld:
        range95 = [forms.low95, forms.high95]
        alternatives = forms.to_list()
    steady = {key: _reported(p, p.estimates, key) for key in ("h_fast", "h_slow", "exponent")}
    for d in p.disks:
        steady[f"{d}_line"] = {
            key: _reported(p, p.estimates, f"{d} {key}") for key in ("intercept", "slope")
        }
    joint: dict[str, Any] = {}
    for d, fit in p.joint.items():
        lag = fit.estimates["lag_s"].model_dump()
        joint[d] = {
            "beta": _reported(p, p.estimates, f"joint {d}"),
            "h": _reported(p, p.estimates, f"h joint {d}"),
            "lag_s": WITHHELD if f"joint {d}" in p.impossible else lag,
        }
    both = {} if p.single_disk else p.combined.estimates
    joint["both"] = {
        key: _reported(p, both, key, "both ") for key in ("beta", "h_fast", "h_slow", "exponent")
    }
    joint["profiles"] = profiles_file(p.profiles) if with_profiles else {}
    return {
        "schema": SCHEMA,
        "source": source,
        "test": test.conditions,
        "steady": {"beta": _reported(p, p.estimates, "speed law"), **steady},
        "transient": {
            d: {
                "beta": _reported(p, p.estimates, f"cooling {d}"),
                "h": _reported(p, p.estimates, f"h cooling {d}"),
                "window_s": fit.window_s,
            }
            for d, fit in p.cooling.items()
        },
        "joint": joint,
        "headline": {
            "beta": recommended_beta,
            "way": f"joint {p.single_disk or 'both'}",
            "sentence": p.recommendation.sentence,
            "range95": range95,
        },
        "status": p.status,
        "alternatives": alternatives,
        "crosscheck": p.crosscheck.to_dict(),
        "budget": [asdict(row) for row in p.budget.rows],
        "budget_both": [{"source": name, "u_beta": u} for name, u in recommended.items()],
        "surface": {
            "fast_max_degC": _reported(p, p.estimates, "surface fast"),
            "slow_max_degC": _reported(p, p.estimates, "surface slow"),
            "delta_T_us": _reported(p, p.estimates, "delta_T_us"),
        },
        "noise": {d: disk.noise.to_dict() for d, disk in test.disks.items()},
        "unevenness": {d: harmonic.to_dict() for d, harmonic in p.combined.harmonics.items()},
        "sensors": {} if p.sensors is None else p.sensors.texts,
        "junctions": junction_depths(p.sensors),
        "findings": [finding.to_dict() for finding in p.findings],
        "warnings": list(p.warnings),
    }


def _reported(
    p: Partition, estimates: Mapping[str, Estimate], key: str, prefix: str = ""
) -> dict[str, Any]:
    """An estimate as in ``beta.json``; nulls where it is withheld or missing.

    Parameters
    ----------
    p
        The partition.
    estimates
        ``p.estimates``, or those of the combined fit.
    key
        Key of the estimate.
    prefix
        Prefix of the key in ``p.impossible``.
    """
    if key not in estimates or f"{prefix}{key}" in p.impossible:
        return WITHHELD
    return estimates[key].model_dump()


def junction_depths(sensor_check: SensorCheck | None) -> dict[str, Any]:
    """Depth of each junction by the test itself, as in ``beta.json``; empty without a sensor check.

    ``deeper_mm`` is the difference from the nominal depth, ``z`` the departure in standard
    deviations, see ``tcdyn.partition.sensor_faults.DepthTest``.
    """
    return {
        d: {
            c: {"deeper_mm": e.scaled(1e3).model_dump(), "z": float(z)}
            for (c, e), z in zip(t.deeper_m.items(), t.pull)
        }
        for d, t in ({} if sensor_check is None else sensor_check.depths).items()
    }
