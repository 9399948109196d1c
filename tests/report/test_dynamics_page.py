"""Pages on dynamics: how much data an identification used, and a live-compensated log with its
band."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from tcdyn.identification import IOData, compare
from tcdyn.report.compensate import _followed_channel_section
from tcdyn.report.dynamics import write_identify_report
from tcdyn.rig.disk import Conditioning
from tcdyn.sensors.file import specified_sensor
from tcdyn.workflows.options import LogOptions
from tcdyn.workflows.raw_log import open_log_table, raw_log
from tests.identify.identify_cases import PLAIN, case_a


def test_identification_page_counts_runs_and_samples(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for figure_name in ("fit_figure", "dynamics_figure", "residual_figure"):
        monkeypatch.setattr(f"tcdyn.report.dynamics.{figure_name}", lambda *_: None)
    single_run = case_a("prbs", 1)
    comparison = compare(single_run, ["P1"], **PLAIN)
    for record, text in (
        (single_run, "1 run, 800 samples at 0.05 s."),
        (single_run.merge(single_run), "2 runs, 1600 samples at 0.05 s."),
    ):
        write_identify_report(tmp_path / "p.html", record, comparison, Conditioning(poles=0))
        assert text in (tmp_path / "p.html").read_text(encoding="utf-8")


@pytest.mark.parametrize("marks", [(",", "."), (";", ",")], ids=["standard", "German"])
def test_figure_of_a_compensated_log_shows_its_95_percent_band_with_a_margin(
    tmp_path: Path, marks: tuple[str, str]
) -> None:
    """Readings from 20 to 60 degC with u of 0.5 K: half the band is 1.96 u; the margin is a tenth
    of 40 K. A spike of the log does not count."""
    t = np.linspace(0.0, 10.0, 5)
    x = np.array([20.0, 30.0, 60.0, 50.0, 40.0])
    frame = pd.DataFrame({"time_s": t, "e_degC": x, "e_u_K": 0.5})
    frame.to_csv(tmp_path / "o.csv", index=False, sep=marks[0], decimal=marks[1])
    readings = np.array([20.0, 30.0, 999.0, 50.0, 40.0])
    logged = pd.DataFrame({"time_s": t, "e_degC": readings})
    logged.to_csv(tmp_path / "log.csv", index=False, sep=marks[0], decimal=marks[1])
    sensor = specified_sensor("probe", ["e_degC"], [(1.0, 0.1)])
    table = open_log_table(tmp_path / "log.csv", [sensor], None, LogOptions())
    log = raw_log(tmp_path / "log.csv", table, [sensor], None, LogOptions())
    section = _followed_channel_section(log, tmp_path / "o.csv")
    assert section.figure is not None
    (ax,) = section.figure.axes
    corners = ax.collections[0].get_paths()[0].vertices
    for time, value in zip(t, x):
        ends = corners[np.isclose(corners[:, 0], time), 1]
        # 1.95996
        assert (ends.min(), ends.max()) == pytest.approx((value - 0.98, value + 0.98), abs=1e-4)
    assert ax.get_ylim() == pytest.approx((16.0, 64.0))


@pytest.mark.e2e
def test_page_of_an_unrelated_output_says_so_and_has_no_response(tmp_path: Path) -> None:
    rng = np.random.default_rng(1)
    u = np.repeat(rng.choice([0.0, 1.0], 20), 20)
    data = IOData.from_arrays(u, rng.normal(size=len(u)), 0.1, hold="zoh")
    comparison = compare(data)
    assert comparison.recommended == "-"
    assert comparison.conclusion.code == "models.unrelated"
    path = tmp_path / "page.html"
    write_identify_report(path, data, comparison, Conditioning(poles=0))
    assert "unrelated to the input" in path.read_text(encoding="utf-8")
