"""Analysis of one log of a campaign: settings, and the results of the tests in it."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from tcdyn.campaign.stages import read_stage
from tcdyn.core.errors import InputError
from tcdyn.core.findings import messages
from tcdyn.io.checksum import with_checksum
from tcdyn.partition.analyse import WINDOW_S
from tcdyn.partition.events import EhlTest
from tcdyn.partition.window import rows_between, steady_start_s
from tcdyn.rig.disk import DISKS
from tcdyn.rig.log import iter_log
from tcdyn.rig.record import DiskRecord
from tcdyn.rig.rigfile import Rig
from tcdyn.version import __version__
from tcdyn.workflows.beta import estimate_beta
from tcdyn.workflows.operating_conditions import BearingFile


@dataclass(frozen=True)
class CampaignSettings:
    """What all logs of a campaign are analysed with; ``without``: channels left out of each, such
    as "fast_c".
    """

    rig: Rig
    records: Mapping[str, DiskRecord]
    window_s: float = WINDOW_S
    seed: int = 0
    bearing: BearingFile | None = None
    without: tuple[str, ...] = ()

    def fingerprint(self) -> dict[str, Any]:
        """What must be the same for a stored answer to stand: version, rig, records, bearing file
        and options.
        """
        return {
            "version": __version__,
            "rig_sha256": _hash(self.rig.model_dump_json()),
            "records_sha256": {d: _hash(r.to_json()) for d, r in sorted(self.records.items())},
            "bearing_sha256": self.bearing.sha256 if self.bearing else None,
            "window_s": self.window_s,
            "seed": self.seed,
            "without": sorted(self.without) or None,
        }


def analyse_log(path: Path, settings: CampaignSettings) -> list[dict[str, Any] | str]:
    """The contents of beta.json of a log's tests with what a campaign adds, or the sentence of a
    test's failure.
    """
    first, count = _try_stage(path, settings, 1)
    return [first, *(_try_stage(path, settings, k)[0] for k in range(2, count + 1))]


def _try_stage(
    path: Path, settings: CampaignSettings, stage: int
) -> tuple[dict[str, Any] | str, int]:
    """One test of a log, and how many it holds as far as that is known."""
    try:
        return _analyse_stage(path, settings, stage)
    except InputError as problem:
        message = str(problem).replace(str(path), path.name)
    except Exception as problem:  # one log must not end a campaign of many
        message = f"{path.name}: not analysed, {type(problem).__name__}: {problem}"
    return message, _count_stages(path, settings) if stage == 1 else 1


def _count_stages(path: Path, settings: CampaignSettings) -> int:
    """How many tests a log holds whose first cannot be analysed; one where it cannot be read."""
    try:
        pieces = iter_log(
            path, "ehl", settings.rig, without=[f"{c}_degC" for c in settings.without]
        )
        return read_stage(pieces, None)[1]
    except InputError:
        return 1


def _analyse_stage(
    path: Path, settings: CampaignSettings, stage: int
) -> tuple[dict[str, Any], int]:
    s = settings
    run = estimate_beta(
        path,
        s.rig,
        s.records,
        window_s=s.window_s,
        seed=s.seed,
        bearing=s.bearing,
        without=s.without,
        stage=stage,
    )
    test = run.partition.test
    data = run.to_dict()
    findings = [
        replace(f, where=f.where.replace(str(path), path.name)) for f in run.partition.findings
    ]
    data["findings"], data["warnings"] = (
        [f.to_dict() for f in findings],
        list(messages(findings[:-1])),
    )
    steady = steady_degC(test)
    data["campaign"] = {
        **settings.fingerprint(),
        "friction_coefficient": test.friction_N / test.load_N,
        "bearing_N": test.added_friction.value_N if settings.bearing else None,
        "bulk_degC": {
            d: float(np.mean([x for x in steady[d].values() if x is not None])) for d in DISKS
        },
        "steady_degC": steady,
        "stages": run.stages,
    }
    return with_checksum(data), run.stages


def steady_degC(test: EhlTest) -> dict[str, dict[str, float | None]]:
    """Mean reading of each junction when steady [degC], None of one left out; their mean is the
    bulk one (6.4.1).
    """
    rows = rows_between(test.time_s, steady_start_s(test), test.events.unload_s - 0.5)
    means = {d: test.disks[d].readings_degC[rows].mean(axis=0) for d in DISKS}
    return {
        d: {
            c: None if c in test.disks[d].excluded else float(x)
            for c, x in zip(test.disks[d].setup.channels, means[d])
        }
        for d in DISKS
    }


def _hash(text: str) -> str:
    return hashlib.sha256(text.encode("utf-8")).hexdigest()
