"""The numbers that a rebuilt house must still give: two records, a compensated log, beta.json, an identification.

``kept_answers.json`` holds those of 0.1.0 (commit 7b16d0d) and, but for case A, those since the plunge leaves the form
of h open and takes the oven's covariance; the test beside it compares. For a rewriting that
must change nothing, ``python -m tests.golden.answers FILE`` writes those of the code at hand, or, where FILE is there,
prints which moved by more than 1e-6 of themselves.
"""

from __future__ import annotations

import json
import math
import sys
import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from tcdyn.identify import fit
from tcdyn.rig.disk import CHANNELS, DISKS
from tcdyn.rig.record import DiskRecord
from tcdyn.workflows import compensate_log, estimate_beta
from tests.identify.identify_cases import case_a

KEPT = Path(__file__).with_name("kept_answers.json")
EVERY = 500  # rows of the compensated log between two that are kept; all of the second after the parting is kept


def answers(campaign: Any) -> dict[str, dict[str, float]]:
    """Every golden number by group and name, from the small campaign of ``tests/conftest.py``."""
    beta = estimate_beta(campaign.files.ehl["B3"], campaign.rig, campaign.records).to_dict()
    return {
        **{f"record {d}": record_numbers(campaign.records[d]) for d in DISKS},
        "beta.json": numbers(beta),
        "compensated": compensated_numbers(campaign),
        "case A": case_a_numbers(),
    }


def record_numbers(record: DiskRecord) -> dict[str, float]:
    """Static lines, the fitted plunges' lags with their covariance, in seconds and kelvin."""
    chain = record.chain
    assert chain is not None
    found: dict[str, Any] = {"common": chain.common_lag_s.value, "common_u": chain.common_lag_s.u}
    for c in CHANNELS:
        line = record.static[c]
        found |= {
            f"{c} gain": line.gain,
            f"{c} offset": line.offset,
            f"{c} covariance": line.covariance,
        }
        found |= {
            f"{c} lag": chain.channels[c].lag_s.value,
            f"{c} lag u": chain.channels[c].lag_s.u,
        }
        found |= {
            f"{c} differential": chain.differential_lag_s[c].value,
            f"{c} diff u": chain.differential_lag_s[c].u,
        }
    return numbers({**found, "lag covariance": chain.covariance})


def compensated_numbers(campaign: Any) -> dict[str, float]:
    """Temperatures and standard uncertainties of every channel, thinly over the test and fully after the parting."""
    records = {
        d: as_sure_as_0_1(record) for d, record in campaign.records.items()
    }  # version 0.1 counted no such
    done = compensate_log(campaign.files.ehl["B3"], records, campaign.rig)
    time = done.frame["time_s"].to_numpy()
    off = campaign.truth["tests"]["B3"]["unload_s"]
    kept = np.flatnonzero(
        (np.arange(len(time)) % EVERY == 0) | ((time > off - 0.2) & (time < off + 1.0))
    )
    columns = [f"{d}_{c}_{unit}" for d in DISKS for c in CHANNELS for unit in ("degC", "u_K")]
    return {
        f"{name} row {i}": float(done.frame[name].iloc[i])
        for name in columns
        for i in kept[:: len(columns) // 3]
    }


def as_sure_as_0_1(record: DiskRecord) -> DiskRecord:
    """The record without doubt of how its lags divide, and of the oven's reference."""
    assert record.chain is not None
    channels = {
        c: own.model_copy(update={"split_u_s": 0.0}) for c, own in record.chain.channels.items()
    }
    static = {c: line.model_copy(update={"shared_u_K": 0.0}) for c, line in record.static.items()}
    chain = record.chain.model_copy(update={"channels": channels})
    return record.model_copy(update={"chain": chain, "static": static})


def case_a_numbers() -> dict[str, float]:
    """Case A, plunge and PRBS, seed 1: parameters and standard uncertainties."""
    found = {}
    for kind in ("plunge", "prbs"):
        m = fit(case_a(kind, 1), "P2D")
        found[kind] = {n: [e.value, e.u] for n, e in m.estimates.items()}
    return numbers(found)


def numbers(value: Any, path: str = "") -> dict[str, float]:
    """All finite numbers in nested dicts and lists, by their path."""
    if isinstance(value, bool | str) or value is None:
        return {}
    if isinstance(value, Mapping):
        return {
            k: v for key, part in value.items() for k, v in numbers(part, f"{path}/{key}").items()
        }
    if isinstance(value, list | tuple | np.ndarray):
        return {
            k: v for i, part in enumerate(value) for k, v in numbers(part, f"{path}/{i}").items()
        }
    return {path: float(value)} if math.isfinite(value) else {}


def main() -> None:
    """Write the numbers of the code at hand, or compare them with those of a file."""
    from tests.conftest import small_campaign

    file = Path(sys.argv[1])
    with tempfile.TemporaryDirectory() as folder:
        now = answers(small_campaign(Path(folder)))
    if not file.exists():
        file.write_text(json.dumps(now, indent=0) + "\n", encoding="utf-8")
        print({group: len(values) for group, values in now.items()})
        return
    for group, then in json.loads(file.read_text(encoding="utf-8")).items():
        for name, value in then.items():
            if not math.isclose(value, now[group].get(name, math.nan), rel_tol=1e-6, abs_tol=1e-10):
                print(f"{group} {name}: {value:.12g} became {now[group].get(name)}")


if __name__ == "__main__":
    main()
