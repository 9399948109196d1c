"""What a record remembers of its rig, what rig.toml says of each disk, and what a gap in a log
leaves unknown."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from tcdyn.cli.app import app, run
from tcdyn.partition.analyse import Partition
from tcdyn.rig.log import write_log
from tcdyn.rig.opened_log import rig_from_records
from tcdyn.rig.record import read_record, write_record
from tcdyn.rig.rigfile import load_rig
from tcdyn.workflows import compensate_log, estimate_beta
from tests.conftest import Campaign


@pytest.fixture(scope="module")
def other_steel(campaign: Campaign, tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    """The records as a rig file with K = 46 W/mK and e at 1.6 mm would have made them."""
    folder = tmp_path_factory.mktemp("records")
    (folder / "rig.toml").write_text(
        "[disk]\nconductivity_W_mK = 46.0\n[thermocouples]\ne = { depth_mm = 1.6, z_mm = 4.765 }\n"
    )
    rig = load_rig(folder / "rig.toml")
    return [
        write_record(
            record.model_copy(update={"setup": rig.tables(disk)}), folder / f"{disk}.disk.json"
        )
        for disk, record in campaign.records.items()
    ]


def speed_law(campaign: Campaign, records: list[Path], *rig: object) -> float:
    """beta by the speed law, as the command prints it."""
    words = [w for r in records for w in ("--record", r)]
    out = records[0].parent / "beta.json"
    command = [
        "rig",
        "beta",
        campaign.files.ehl["B3"],
        *words,
        *rig,
        "--out",
        out,
        "--no-sensor-check",
        "--quiet",
    ]
    # steel and depth are not so
    assert run(lambda: app([str(w) for w in command], standalone_mode=False)) in (0, 1)
    return float(json.loads(out.read_text())["steady"]["beta"]["value"])


@pytest.mark.long
@pytest.mark.e2e
def test_without_a_rig_file_the_records_rig_is_used(
    campaign: Campaign, other_steel: list[Path]
) -> None:
    """It was the design's defaults before: beta 0.02 off, without a word."""
    own = speed_law(campaign, other_steel, "--rig", other_steel[0].parent / "rig.toml")
    assert speed_law(campaign, other_steel) == pytest.approx(own, abs=1e-9)
    assert abs(own - speed_law(campaign, other_steel, "--rig", campaign.files.rig)) > 0.01


@pytest.mark.long
@pytest.mark.e2e
def test_a_rig_file_that_is_not_the_records_is_said(
    campaign: Campaign, partition: Partition, other_steel: list[Path]
) -> None:
    records = {r.disk: r for r in map(read_record, other_steel)}
    run_ = estimate_beta(campaign.files.ehl["B3"], campaign.rig, records, sensor_check=False)
    said = [w for w in run_.partition.warnings if "what the record was made with" in w]
    assert len(said) == 2
    assert "[disk] conductivity_W_mK = 41.0 (record: 46.0)" in said[0]
    assert "[thermocouples] e.depth_mm = 1.25 (record: 1.6)" in said[0]
    assert not [w for w in partition.warnings if "record" in w]


def test_one_record_alone_remembers_its_columns(campaign: Campaign) -> None:
    setup = campaign.records["slow"].setup.model_copy(update={"columns": {"load_N": "Load"}})
    record = campaign.records["slow"].model_copy(update={"setup": setup})
    assert rig_from_records({"slow": record}).columns()["load_N"] == "Load"


@pytest.mark.long
@pytest.mark.e2e
def test_uncertainties_of_one_disk_widen_that_disk(
    campaign: Campaign, partition: Partition, tmp_path: Path
) -> None:
    stated = campaign.files.rig.read_text()
    (tmp_path / "rig.toml").write_text(stated + "\n[slow.uncertainty]\ndepth_mm = 0.5\n")
    rig = load_rig(tmp_path / "rig.toml")
    wider = estimate_beta(
        campaign.files.ehl["B3"], rig, campaign.records, sensor_check=False
    ).partition
    for disk, least, most in (("fast", 0.95, 1.05), ("slow", 2.0, 6.0)):
        grown = np.std(wider.budget.samples[f"cooling {disk}"]) / np.std(
            partition.budget.samples[f"cooling {disk}"]
        )
        assert least < grown < most


@pytest.mark.long
@pytest.mark.e2e
def test_disks_of_other_radii_have_another_track(campaign: Campaign, tmp_path: Path) -> None:
    """A slow disk twice as crowned: the track is that of two equal disks with the mean of both
    curvatures."""
    from tcdyn.rig.contact import half_width_m

    (tmp_path / "rig.toml").write_text("[slow.disk]\ncrown_radius_mm = 152.4\n")
    rig = load_rig(tmp_path / "rig.toml")
    test = estimate_beta(
        campaign.files.ehl["B3"], rig, campaign.records, sensor_check=False
    ).partition.test
    assert test.half_width_m == pytest.approx(
        half_width_m(test.load_N, 0.0381, 2 / (1 / 0.3048 + 1 / 0.1524))
    )
    assert test.half_width_m < 0.9 * half_width_m(test.load_N)


@pytest.mark.e2e
@pytest.mark.long
def test_a_gap_after_the_parting_is_no_straight_line(campaign: Campaign, tmp_path: Path) -> None:
    """0.44 s of e missing from the parting on: bridged by a straight line, the trace was 0.4 K rms
    off."""
    frame = pd.read_csv(campaign.files.ehl["B3"])
    whole = compensate_log(campaign.files.ehl["B3"], campaign.records).frame
    parting = int(np.flatnonzero((frame["contact"] > 0.5).to_numpy())[-1])
    gap = slice(parting, parting + 33)
    frame.loc[frame.index[gap], "fast_e_degC"] = np.nan
    done = compensate_log(write_log(frame, tmp_path / "gap.csv"), campaign.records).frame
    off = (done["fast_e_degC"] - whole["fast_e_degC"]).to_numpy()[gap]
    u, before = (t["fast_e_u_K"].to_numpy()[gap] for t in (done, whole))
    assert np.sqrt(np.mean(off**2)) < 0.15  # a compensated sample is known to 0.2 K there
    assert (np.abs(off) < 2 * u).all()
    assert u.sum() > 1.02 * before.sum()
