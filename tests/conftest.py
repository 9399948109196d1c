"""Fixtures of several test folders: a small campaign of the synthetic rig."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

from tcdyn.rig.record import DiskRecord, read_record
from tcdyn.rig.rigfile import Rig, load_rig
from tcdyn.simulate.campaign import CampaignFiles, simulate_campaign
from tcdyn.simulate.ehl import EhlOptions

if TYPE_CHECKING:
    from tcdyn.partition.analyse import Partition
    from tcdyn.workflows import CalibrationRun
    from tcdyn.workflows.beta import BetaRun

SEED = 3
DISKS = ("fast", "slow")
RECORDS = Path(__file__).parent / "behaviour" / "data"


def pytest_addoption(parser: pytest.Parser) -> None:
    """``--full``: Monte Carlo studies with all of their draws, as README's figures have them; a
    quarter without."""
    parser.addoption(
        "--full", action="store_true", help="studies with all of their draws, a quarter without"
    )


@pytest.fixture(scope="session")
def draws(request: pytest.FixtureRequest) -> Callable[[int], int]:
    """How many of a study's draws are made in this run."""
    return lambda full: full if request.config.getoption("--full") else full // 4


SLOW_FIXTURES = {
    "beta_run",
    "partition",
    "calibrations",
    "beta_json",
    "said",
    "uneven_disks",
    "braked_with_second_contact",
}


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Tests that use a complete ``beta`` or ``calibrate`` run are e2e tests; long tests need
    ``--full``."""
    for item in items:
        if SLOW_FIXTURES & set(getattr(item, "fixturenames", ())):
            item.add_marker(pytest.mark.e2e)
        if item.get_closest_marker("long") and not config.getoption("--full"):
            item.add_marker(pytest.mark.skip(reason="a long test: only with --full"))


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
    """Ovens, two plunges a disk and test B3, loaded for 300 s only; the records are committed."""
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
    """Simulate the campaign of the fixture into ``folder``; its records are those of the behaviour
    suite."""
    options = EhlOptions(load_on_s=30.0, unload_s=330.0, duration_s=350.0)
    files = simulate_campaign(folder, SEED, ("B3",), ehl_options=options)
    record_paths = {}
    for disk in DISKS:
        record_paths[disk] = folder / f"{disk}.disk.json"
        shutil.copyfile(RECORDS / f"{disk}.disk.json", record_paths[disk])
    return Campaign(
        files=files,
        rig=load_rig(files.rig),
        records={disk: read_record(path) for disk, path in record_paths.items()},
        record_paths=record_paths,
        truth=json.loads(files.truth.read_text(encoding="utf-8")),
    )
