"""Logs too long for the memory: what surrounds the unloading is kept, all is compensated stretch by
stretch."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pandas as pd
import pytest

from tcdyn.campaign import stages
from tcdyn.core.errors import InputError
from tcdyn.rig.log import iter_log, read_log, write_log
from tcdyn.sensors import compensation as engine
from tcdyn.sensors import segments
from tcdyn.sensors.compensation import CompensatedSegment, CompensationMethod
from tcdyn.workflows import compensate, compensate_log
from tcdyn.workflows.compensate import LogSegments
from tests.cli.test_compensate_command import both, tcdyn, whole
from tests.conftest import Campaign

__all__ = ["whole"]


@pytest.fixture
def small(monkeypatch: pytest.MonkeyPatch) -> None:
    """So little memory that the campaign's log of 26,000 rows is long."""
    for room in (stages, compensate):
        monkeypatch.setattr(room, "MAX_ROWS", 12_000)
    monkeypatch.setattr(compensate, "SEGMENT_ROWS", 9_000)
    monkeypatch.setattr(segments, "FLOOR", 1e-4)  # margins of 5,120 rows, segments of 15,360


@pytest.mark.usefixtures("small")
def test_of_a_long_log_the_rows_about_the_unloading_are_kept_as_they_are(
    campaign: Campaign,
) -> None:
    pieces = iter_log(campaign.files.ehl["B3"], "ehl", campaign.rig)
    log, count = stages.read_stage(pieces, None)
    assert count == 1
    time = log.frame["time_s"]
    assert [time.iloc[0], time.iloc[-1]] == pytest.approx(
        [330 - stages.MIN_WINDOW_S[1], 350], abs=0.5
    )
    full = read_log(campaign.files.ehl["B3"], "ehl", campaign.rig).frame
    same = full[full["time_s"] >= time.iloc[0]].reset_index(drop=True)
    pd.testing.assert_frame_equal(log.frame, same)
    assert [(f.code, f.numbers["count"]) for f in log.findings if f.code == "log.long"] == [
        ("log.long", len(full))
    ]
    with pytest.raises(InputError, match="no loading number 2"):
        stages.read_stage(pieces, 2)


@pytest.mark.e2e
@pytest.mark.usefixtures("small")
@pytest.mark.parametrize("ending", [".csv", pytest.param(".parquet", marks=pytest.mark.long)])
def test_a_long_log_is_compensated_as_in_one_piece(
    campaign: Campaign, tmp_path: Path, whole: pd.DataFrame, ending: str
) -> None:
    """Noise and intensity of each stretch are its own: the answers part by a small part of their
    uncertainty.

    Segments here are a sixth as long as in a log of a million rows, where the rms is 0.01 u.
    """
    out = tmp_path / f"out{ending}"
    assert (
        tcdyn("compensate", campaign.files.ehl["B3"], *both(campaign), "--out", out, "--quiet") == 0
    )
    made = pd.read_csv(out) if ending == ".csv" else pd.read_parquet(out)
    assert list(made) == list(whole)
    assert len(made) == len(whole)
    for name in (n for n in whole if n.endswith("_u_K")):
        of, u = name.replace("_u_K", "_degC"), whole[name].to_numpy()
        apart = np.abs(made[of] - whole[of]) / u
        assert np.sqrt(np.mean(apart**2)) < 0.05
        assert np.quantile(apart, 0.99) < 0.25
        assert apart.max() < 2.0
        # the intensities after an event have other segments where a piece ends earlier
        change = np.abs(made[name] / u - 1)
        assert np.quantile(change, 0.95) < 0.1, (name, np.quantile(change, [0.9, 0.95, 0.99]))
        assert change.max() < 1.0
    rest = [n for n in whole if not n.endswith("_u_K") and n.replace("_degC", "_u_K") not in whole]
    pd.testing.assert_frame_equal(made[rest], whole[rest])


@pytest.mark.long
@pytest.mark.e2e
@pytest.mark.usefixtures("small")
def test_a_long_log_without_unloading_and_a_place_that_cannot_be_written(
    campaign: Campaign, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    frame = pd.read_csv(campaign.files.ehl["B3"])
    loaded = write_log(frame[frame["time_s"].between(100, 150)], tmp_path / "loaded.csv")
    monkeypatch.setattr(compensate, "MAX_ROWS", 2_000)
    monkeypatch.setattr(stages, "MAX_ROWS", 2_000)
    done = compensate_log(loaded, campaign.records, campaign.rig)
    assert len(done.frame) == 2_000
    path, noticed = done.write(tmp_path / "out.csv")
    assert len(pd.read_csv(path)) == 50 * 75 + 1
    assert "compensate.unrefined" in {f.code for f in noticed}
    with pytest.raises(InputError, match=r"\.tdms"):
        done.write(tmp_path / "out.tdms")
    assert not (tmp_path / "out.tdms").exists()


def test_of_every_tenth_that_is_written_one_line_is_told(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    def in_four(*_: object, **__: object) -> Iterator[SimpleNamespace]:
        for rows in (3, 4, 6, 27):  # of 40: 7, 17, 32 and 100 %
            yield SimpleNamespace(time_s=np.zeros(rows), keep=slice(None))

    def compensated(segment: SimpleNamespace, *_: object) -> CompensatedSegment:
        return CompensatedSegment(cast(Any, segment), {"time_s": segment.time_s}, {}, {}, {}, [])

    monkeypatch.setattr(engine, "read_segments", in_four)
    monkeypatch.setattr(engine, "compensate_segment", compensated)
    log = cast(Any, SimpleNamespace(rows=40))
    channels = cast(Any, SimpleNamespace(lag_s=1.0))
    segments = LogSegments(log, channels, CompensationMethod(), {}, ["time_s"], ["time_s"], {})
    told: list[str] = []
    assert segments.write(tmp_path / "out.csv", told.append) == []
    assert told == [f"writing, {percent} % of the rows" for percent in (10, 30, 100)]
    assert len(pd.read_csv(tmp_path / "out.csv")) == 40
