"""Analysis of one log of a campaign: settings, and the results of the tests in it.

``analyse_log`` runs in a worker process of ``tcdyn.workflows.campaign.run_campaign``, so that
arguments and results can be pickled. Guarded by ``tests/cli/test_campaign_command.py``.
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from tcdyn.campaign.stages import read_stage
from tcdyn.campaign.steady_maps import logged_map_degC, steady_degC
from tcdyn.core.errors import InputError
from tcdyn.core.findings import messages
from tcdyn.io.checksum import with_checksum
from tcdyn.rig.disk import DISKS
from tcdyn.rig.log import iter_log
from tcdyn.rig.record import DiskRecord
from tcdyn.rig.rigfile import Rig
from tcdyn.version import __version__
from tcdyn.workflows.beta import estimate_beta
from tcdyn.workflows.rig_options import AnalysisOptions


@dataclass(frozen=True)
class CampaignSettings:
    """What all logs of a campaign are analysed with.

    Parameters
    ----------
    rig, records
        The rig, and the record of each disk.
    options
        How each log is analysed.
    """

    rig: Rig
    records: Mapping[str, DiskRecord]
    options: AnalysisOptions = field(default_factory=AnalysisOptions)

    def fingerprint(self) -> dict[str, Any]:
        """What must be the same for a stored result to be used: version, rig, records, options.

        A new setting that changes results must be added here; otherwise old results would be kept.
        """
        options = self.options
        bearing = options.bearing_file
        return {
            "version": __version__,
            "rig_sha256": _text_sha256(self.rig.model_dump_json()),
            "records_sha256": {
                d: _text_sha256(r.to_json()) for d, r in sorted(self.records.items())
            },
            "bearing_sha256": bearing.sha256 if bearing else None,
            "window_s": options.window_s,
            "seed": options.seed,
            "without": sorted(options.without) or None,
            "reading": asdict(self.rig.reading),
        }


def analyse_log(path: Path, settings: CampaignSettings) -> list[dict[str, Any] | str]:
    """Results of all tests in a log; the message of the failure where one cannot be analysed.

    Parameters
    ----------
    path
        The log.
    settings
        Settings of the campaign.

    Returns
    -------
    list
        For each test the content of beta.json with the key ``campaign``, or a message.
    """
    first, count = _try_stage(path, settings, 1)
    return [first, *(_try_stage(path, settings, k)[0] for k in range(2, count + 1))]


def _try_stage(
    path: Path, settings: CampaignSettings, stage: int
) -> tuple[dict[str, Any] | str, int]:
    """Analyse one test of a log; no error ends the campaign.

    Parameters
    ----------
    path, settings
        As for ``analyse_log``.
    stage
        Number of the test in the log, from 1.

    Returns
    -------
    result
        Content of beta.json, or the message of the failure.
    count
        Number of tests in the log as far as it is known.
    """
    try:
        return _analyse_stage(path, settings, stage)
    except InputError as problem:
        message = str(problem).replace(str(path), path.name)
    except Exception as problem:  # one log must not end a campaign of many
        message = f"{path.name}: not analysed, {type(problem).__name__}: {problem}"
    return message, _count_stages(path, settings) if stage == 1 else 1


def _count_stages(path: Path, settings: CampaignSettings) -> int:
    """Number of tests in a log whose first cannot be analysed; one where it cannot be read."""
    try:
        columns = [f"{channel}_degC" for channel in settings.options.without]
        return read_stage(iter_log(path, "ehl", settings.rig, without=columns), None)[1]
    except InputError:
        return 1


def _analyse_stage(
    path: Path, settings: CampaignSettings, stage: int
) -> tuple[dict[str, Any], int]:
    """Analyse one test of a log; parameters and result as for ``_try_stage``.

    Paths in messages are shortened to the name of the log, so that results do not depend on
    folders.
    """
    options = {**settings.options.stated, "stage": stage}
    run = estimate_beta(path, settings.rig, settings.records, **options)
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
        "bearing_N": test.added_friction.value_N if settings.options.bearing else None,
        "bulk_degC": {
            d: float(np.mean([x for x in steady[d].values() if x is not None])) for d in DISKS
        },
        "steady_degC": steady,
        "map_degC": logged_map_degC(test, run.log.frame, run.records),
        "stages": run.stages,
    }
    return with_checksum(data), run.stages


def _text_sha256(text: str) -> str:
    """SHA-256 of a text as hexadecimal digits."""
    return hashlib.sha256(text.encode("utf-8")).hexdigest()
