"""Fixtures of several test folders: a small campaign of the synthetic rig, from committed logs."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

from tcdyn.rig.record import DiskRecord, read_record
from tcdyn.rig.rigfile import Rig, load_rig
from tcdyn.simulate.campaign import CampaignFiles
from tests.behaviour.logs import write_logs

if TYPE_CHECKING:
    from tcdyn.partition.analyse import Partition
    from tcdyn.workflows import CalibrationRun
    from tcdyn.workflows.beta import BetaRun

DISKS = ("fast", "slow")


def pytest_addoption(parser: pytest.Parser) -> None:
    """``--full``: Monte Carlo studies with all of their draws, as README's figures have them; a quarter without."""
    parser.addoption(
        "--full", action="store_true", help="studies with all of their draws, a quarter without"
    )


@pytest.fixture(scope="session")
def draws(request: pytest.FixtureRequest) -> Callable[[int], int]:
    """How many of a study's draws are made in this run."""
    return lambda full: full if request.config.getoption("--full") else full // 4


@dataclass(frozen=True)
class Campaign:
    """A short campaign on disk, its records, and its truth for the tests to compare with."""

    files: CampaignFiles
    rig: Rig
    records: dict[str, DiskRecord]
    record_paths: dict[str, Path]
    truth: dict[str, Any]


@pytest.fixture(scope="session")
def campaign(tmp_path_factory: pytest.TempPathFactory) -> Campaign:
    """The committed logs of the behaviour suite: ovens, two plunges a disk, and test B3, loaded for 200 s."""
    return small_campaign(tmp_path_factory.mktemp("campaign"))


@pytest.fixture(scope="session")
def calibrations(campaign: Campaign) -> dict[str, CalibrationRun]:
    """Both disks of that campaign, calibrated."""
    from tcdyn.workflows import calibrate_disk

    return {
        disk: calibrate_disk(
            campaign.rig,
            disk,
            campaign.files.ovens[disk],
            campaign.files.plunges[disk],
            ["mobil-jet-ii"],
        )
        for disk in DISKS
    }


@pytest.fixture(scope="session")
def beta_run(campaign: Campaign) -> BetaRun:
    """Heat partition of test B3 of that campaign, made once for all who read it."""
    from tcdyn.workflows import estimate_beta

    return estimate_beta(campaign.files.ehl["B3"], campaign.rig, campaign.records)


@pytest.fixture(scope="session")
def partition(beta_run: BetaRun) -> Partition:
    """The analysis in that run."""
    return beta_run.partition


def small_campaign(folder: Path) -> Campaign:
    """The campaign of the fixture, its files copied into ``folder``."""
    paths = write_logs(folder)
    ehl_log = paths["ehl_B3"].rename(folder / "EHL_B3.csv")
    truth_path = paths["truth"]
    files = CampaignFiles(
        folder=folder,
        rig=paths["rig"],
        truth=truth_path,
        ovens={disk: paths[f"oven_{disk}"] for disk in DISKS},
        plunges={disk: tuple(paths[f"plunge_{disk}_{k}"] for k in (1, 2)) for disk in DISKS},
        ehl={"B3": ehl_log},
        traces={},
    )
    record_paths = {disk: paths[disk] for disk in DISKS}
    return Campaign(
        files=files,
        rig=load_rig(files.rig),
        records={disk: read_record(path) for disk, path in record_paths.items()},
        record_paths=record_paths,
        truth=json.loads(truth_path.read_text(encoding="utf-8")),
    )
