"""The content of beta.json.

The keys are read by other programs and by ``tcdyn.campaign.summary_table``: a new one is described
in docs/files.md, and a test compares them.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict
from typing import Any

from tcdyn.core.estimate import Estimate
from tcdyn.io.stored import BETA
from tcdyn.partition.analyse import Partition
from tcdyn.partition.joint_results import joint_budget
from tcdyn.partition.profile import profiles_file
from tcdyn.partition.sensor_check import SensorCheck

# an estimate that is withheld
WITHHELD: dict[str, Any] = dict.fromkeys(("value", "u", "low95", "high95"))


def beta_file(
    partition: Partition, source: dict[str, str], with_profiles: bool = False
) -> dict[str, Any]:
    """The content of ``beta.json`` without sufficient statistics and checksum.

    Parameters
    ----------
    partition
        The partition.
    source
        Name and SHA-256 of the log.
    with_profiles
        Whether to compute the likelihood profiles of the joint fits; otherwise, and where beta is
        withheld, ``profiles`` is empty.

    Returns
    -------
    dict
        Every estimate is {value, u, low95, high95}, null where it is withheld or needs a disk that
        was not logged; h in W/m2K, lags in s, depths of junctions in mm.

    Notes
    -----
    The schema changes with the meaning of a key (``tcdyn.io.stored``).
    ``tcdyn.campaign.summary_table.COLUMNS`` uses the same keys.
    """
    test = partition.test
    forms = partition.model_forms
    is_withheld = partition.status == "withheld"
    recommended = joint_budget(partition)
    recommended_beta = _estimate_entry(partition, partition.combined.estimates, "beta", "both ")
    range95 = None
    alternatives = []
    if forms is not None and not is_withheld:
        range95 = [forms.low95, forms.high95]
        alternatives = forms.to_list()
    steady = {
        key: _estimate_entry(partition, partition.estimates, key)
        for key in ("h_fast", "h_slow", "exponent")
    }
    for d in partition.disks:
        steady[f"{d}_line"] = {
            key: _estimate_entry(partition, partition.estimates, f"{d} {key}")
            for key in ("intercept", "slope")
        }
    joint: dict[str, Any] = {}
    for d, fit in partition.joint.items():
        lag = fit.estimates["lag_s"].model_dump()
        joint[d] = {
            "beta": _estimate_entry(partition, partition.estimates, f"joint {d}"),
            "h": _estimate_entry(partition, partition.estimates, f"h joint {d}"),
            "lag_s": WITHHELD if f"joint {d}" in partition.impossible else lag,
        }
    both = {} if partition.single_disk else partition.combined.estimates
    joint["both"] = {
        key: _estimate_entry(partition, both, key, "both ")
        for key in ("beta", "h_fast", "h_slow", "exponent")
    }
    joint["profiles"] = {}
    if with_profiles and not is_withheld:
        joint["profiles"] = profiles_file(partition.profiles)
    return {
        "schema": BETA.schema,
        "source": source,
        "test": test.conditions,
        "steady": {"beta": _estimate_entry(partition, partition.estimates, "speed law"), **steady},
        "transient": {
            d: {
                "beta": _estimate_entry(partition, partition.estimates, f"cooling {d}"),
                "h": _estimate_entry(partition, partition.estimates, f"h cooling {d}"),
                "window_s": fit.window_s,
            }
            for d, fit in partition.cooling.items()
        },
        "joint": joint,
        "headline": {
            "beta": recommended_beta,
            "way": f"joint {partition.single_disk or 'both'}",
            "sentence": partition.recommendation.sentence,
            "range95": range95,
        },
        "status": partition.status,
        "alternatives": alternatives,
        "crosscheck": partition.crosscheck.to_dict(),
        "budget": [asdict(row) for row in partition.budget.rows],
        "budget_both": [{"source": name, "u_beta": u} for name, u in recommended.items()],
        "surface": {
            "fast_max_degC": _estimate_entry(partition, partition.estimates, "surface fast"),
            "slow_max_degC": _estimate_entry(partition, partition.estimates, "surface slow"),
            "delta_T_us": _estimate_entry(partition, partition.estimates, "delta_T_us"),
        },
        "noise": {d: disk.noise.to_dict() for d, disk in test.disks.items()},
        "unevenness": {
            d: harmonic.to_dict() for d, harmonic in partition.combined.harmonics.items()
        },
        "sensors": {} if partition.sensors is None else partition.sensors.texts,
        "junctions": junction_depths(partition.sensors),
        "findings": [finding.to_dict() for finding in partition.findings],
        "warnings": list(partition.warnings),
    }


def _estimate_entry(
    partition: Partition, estimates: Mapping[str, Estimate], key: str, prefix: str = ""
) -> dict[str, Any]:
    """An estimate as in ``beta.json``; nulls where it is withheld or missing.

    Parameters
    ----------
    partition
        The partition.
    estimates
        ``partition.estimates``, or those of the combined fit.
    key
        Key of the estimate.
    prefix
        Prefix of the key in ``partition.impossible``.
    """
    if key not in estimates or f"{prefix}{key}" in partition.impossible:
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
