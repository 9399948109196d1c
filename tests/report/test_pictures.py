"""Marks, lines and labels of figures lie where the plotted numbers are."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pandas as pd
import pytest
from matplotlib.axes import Axes
from matplotlib.text import Annotation

from calibration.static_lines import fit_static_lines
from tcdyn.chain import Chain
from tcdyn.core.estimate import Z95, Estimate
from tcdyn.estimation.line_fit import fit_line
from tcdyn.plots import calibration as pictures
from tcdyn.plots import partition as partitions
from tcdyn.plots.campaign import name_points
from tcdyn.plots.compensate import draw_compensated, draw_filter_report
from tcdyn.plots.style import figure
from tcdyn.plots.transient import draw_inverse_check
from tcdyn.rig.rigfile import load_rig
from tcdyn.rig.static_line import static_u
from tests.pictures import bars
from tests.rig.log_cases import oven_frame

RIG = load_rig()


def points_of(line: Any) -> np.ndarray:
    """Points (N, 2) of a line."""
    return np.transpose(line.get_data()).astype(float)


def axes() -> Axes:
    """New axes."""
    return figure()[1][0]


def partition_with_unloading() -> Any:
    """A log of 20 000 rows at 10 Hz with unloading at 1500 s, analysed from row 10 000 on; both
    disks as in the rig file."""
    time_s = np.arange(20_000) / 10
    rows = slice(10_000, 20_000)
    disks = {}
    compensated = {}
    for disk, offset in (("fast", 0.0), ("slow", 100.0)):
        setup = RIG.disk_setup(disk)
        readings = offset + np.arange(len(setup.channels)) + time_s[:, None] / 100
        disks[disk] = SimpleNamespace(setup=setup, excluded="", readings_degC=readings)
        compensated[disk] = SimpleNamespace(
            temperature=readings[rows] + 1.0, sd=np.full_like(readings[rows], 0.25)
        )
    events = SimpleNamespace(unload_s=1500.0, load_on_s=50.0)
    return SimpleNamespace(
        test=SimpleNamespace(time_s=time_s, events=events, disks=disks),
        rows=rows,
        compensated=compensated,
    )


def test_unloading_figure_shows_compensated_traces_with_95_percent_bands() -> None:
    p = partition_with_unloading()
    ax = partitions.draw_unloading(p, "slow", axes(), before_s=2.0, after_s=4.0)
    setup = p.test.disks["slow"].setup
    lines = [line for line in ax.lines if len(points_of(line)) == 61]  # of six seconds
    channels = list(partitions.plotted_channels(setup, ""))
    assert len(channels) == 3
    assert [line.get_label() for line in lines[1::2]] == [
        f"{c}, {1e3 * setup.junctions[c].depth_m:g} mm deep, compensated" for c in channels
    ]
    assert "e, 1.25 mm deep, compensated" in [line.get_label() for line in lines]
    for c, logged, compensated, band in zip(channels, lines[::2], lines[1::2], ax.collections):
        level = 100.0 + setup.channels.index(c) + 15.0  # at unloading
        t, y = points_of(logged).T
        assert (t[0], t[-1]) == pytest.approx((-2.0, 4.0))
        assert y == pytest.approx(level + t / 100)
        assert points_of(compensated)[:, 1] == pytest.approx(y + 1.0)
        low, high = band.get_datalim(ax.transData).intervaly
        assert (low, high) == pytest.approx((y[0] + 1 - 0.25 * Z95, y[-1] + 1 + 0.25 * Z95))


def test_temperatures_of_a_complete_test_are_plotted_by_4000_of_20_000_rows() -> None:
    p = partition_with_unloading()
    ax = partitions.draw_temperatures(p, axes())
    *channels, on, off = ax.lines
    assert len(channels) == 6
    for line in channels:
        disk, c = str(line.get_label()).split()
        level = (100.0 if disk == "slow" else 0.0) + p.test.disks[disk].setup.channels.index(c)
        t, y = points_of(line).T
        assert len(t) == 4000
        assert (t[0], t[-1]) == pytest.approx((0.0, 1999.9))
        assert y == pytest.approx(level + t / 100)
    assert (on.get_xdata()[0], off.get_xdata()[0]) == (50.0, 1500.0)  # type: ignore[index]


@pytest.mark.parametrize(("disk", "word"), [("fast", "A + B h"), ("slow", "1 - (C + D h)")])
def test_partition_line_of_a_disk_passes_through_points_on_it(disk: str, word: str) -> None:
    heat_share = SimpleNamespace(intercept=0.2, slope=1e-4)
    h = {
        estimator: Estimate.normal(value, 50.0)
        for estimator, value in ((f"cooling {disk}", 800.0), (f"joint {disk}", 1000.0))
    }
    beta = {w: Estimate.normal(0.2 + 1e-4 * e.value, 0.01) for w, e in h.items()}
    if disk == "slow":
        beta = {w: Estimate.normal(1 - e.value, e.u) for w, e in beta.items()}
    estimates = {**beta, **{f"h {w}": e for w, e in h.items()}}
    p: Any = SimpleNamespace(
        disks=(disk,),
        estimates=estimates,
        impossible=(),
        lines={disk: SimpleNamespace(line=heat_share)},
    )
    ax = partitions.draw_lines(p, axes())
    line = points_of(ax.lines[0])
    assert word in str(ax.lines[0].get_label())
    assert line[:, 0] == pytest.approx([0.0, 1250.0])  # a quarter beyond the larger h
    marks, low, high = bars(ax)
    assert marks.astype(float) == pytest.approx(
        np.array([[e.value, beta[w].value] for w, e in h.items()])
    )
    for x, y in marks:
        assert np.interp(x, *line.T) == pytest.approx(y)
    assert (high - low)[::2] == pytest.approx(2 * Z95 * 50.0)  # those along h


def test_line_of_a_transducer_ends_at_its_points() -> None:
    load = np.array([500.0, 1000.0, 3000.0])
    bearing: Any = SimpleNamespace(speeds_rpm=[400.0], lines=[fit_line(load, 3.0 + load / 250)])
    dots, through = pictures.draw_bearing(bearing, axes()).lines
    assert dots.get_label() == "400 rpm"
    assert points_of(through) == pytest.approx(np.array([[500.0, 5.0], [3000.0, 15.0]]))


def test_residuals_of_channels_are_plotted_side_by_side_in_a_95_percent_band() -> None:
    oven = fit_static_lines(oven_frame())
    ax = pictures.draw_residuals(oven, axes())
    prt = oven.residuals["prt_degC"].to_numpy(dtype=float)
    positions = np.array([points_of(line)[:, 0] for line in ax.lines[:6]])
    assert positions.mean(axis=0) == pytest.approx(prt)
    assert np.diff(positions, axis=0) == pytest.approx(0.006 * np.ptp(prt))
    for line in ax.lines[:6]:
        assert points_of(line)[:, 1] == pytest.approx(
            oven.residuals[f"{line.get_label()}_degC"].to_numpy()
        )
    tones = [float(str(line.get_color())) for line in ax.lines[:6]]
    assert tones == pytest.approx(np.linspace(0.0, 0.6, 6))  # black to grey
    first = next(iter(oven.lines.values()))
    (band,) = ax.collections
    widest = 1.96 * static_u(first, first.range_degC).max()  # at the ends
    assert band.get_datalim(ax.transData).intervaly == pytest.approx([-widest, widest])
    assert ax.lines[6].get_ydata() == pytest.approx([0.0, 0.0])


def test_lag_budget_shows_pairs_of_bars_with_the_largest_on_top() -> None:
    components: Any = [
        SimpleNamespace(source=name, u_common_s=common, u_differential_s=differential)
        for name, common, differential in (
            ("depth", 0.04, 0.01),
            ("noise", 0.01, 0.02),
            ("h", 0.1, 0.0),
        )
    ]
    ax = pictures.draw_lag_budget(components, axes())
    common, differential = ax.containers
    for bars_drawn, offset, lengths in (
        (common, 0.19, [0.01, 0.04, 0.1]),
        (differential, -0.19, [0.02, 0.01, 0.0]),
    ):
        assert [b.get_width() for b in bars_drawn] == pytest.approx(lengths)
        assert [b.get_y() + b.get_height() / 2 for b in bars_drawn] == pytest.approx(
            np.arange(3) + offset
        )
    assert [t.get_text() for t in ax.get_yticklabels()] == ["noise", "depth", "h"]
    assert ax.get_xlim() == pytest.approx((0.0, 0.11))
    for text in ax.texts:
        x, y = text.get_position()
        bar = [
            b for b in (*common, *differential) if abs(b.get_y() + b.get_height() / 2 - y) < 1e-9
        ]
        assert len(bar) == 1
        assert float(text.get_text()) == pytest.approx(bar[0].get_width())
        # a hundredth of the longest bar beyond its end
        assert x == pytest.approx(bar[0].get_width() + 0.001)


def test_error_histogram_counts_all_errors_and_marks_the_95_percent_limits() -> None:
    errors = np.linspace(-1.0, 1.0, 201)
    ax = pictures.draw_error_histogram([*errors, np.nan], axes())
    (counts,) = ax.containers
    assert sum(b.get_height() for b in counts) == 201  # type: ignore[attr-defined]
    assert [b.get_width() for b in counts] == pytest.approx([0.1] * len(counts))  # type: ignore[attr-defined]
    assert ax.get_ylabel() == "errors per 0.1 K"
    assert [line.get_xdata()[0] for line in ax.lines] == pytest.approx([0.0, -0.95, 0.95])  # type: ignore[index]


def test_histogram_of_equal_errors_has_one_full_bin() -> None:
    ax = pictures.draw_error_histogram(np.full(5, 0.25), axes())
    heights = [b.get_height() for b in ax.containers[0]]  # type: ignore[attr-defined]
    assert [height for height in heights if height] == [5]


def test_oven_log_is_plotted_as_errors_and_a_trace_by_at_most_4000_points() -> None:
    prt = np.linspace(20.0, 160.0, 8)
    oven: Any = SimpleNamespace(
        frame=pd.DataFrame({"prt_degC": prt, "a_degC": prt + 0.5}),
        kind="oven",
        channels=["a_degC"],
        metadata={},
    )
    (dots,) = pictures.draw_log(oven, axes()).lines
    assert points_of(dots) == pytest.approx(np.column_stack([prt, np.full(8, 0.5)]))
    names = [f"{c}_degC" for c in "abcdefgh"]
    t = np.arange(12_000) / 75
    log: Any = SimpleNamespace(
        frame=pd.DataFrame({"time_s": t, **dict.fromkeys(names, t)}),
        kind="ehl",
        channels=names,
        metadata={},
    )
    lines = pictures.draw_log(log, axes()).lines
    time_s, values = points_of(lines[0]).T
    assert len(time_s) == 4000
    assert values == pytest.approx(time_s)
    assert (time_s[0], time_s[-1]) == pytest.approx((t[0], t[-1]))
    assert [line.get_linestyle() for line in lines] == ["-"] * 6 + ["--"] * 2
    assert lines[0].get_color() == lines[6].get_color() != lines[1].get_color()


@pytest.mark.parametrize("taus_s", [(2.0,), (1.5, 0.5)])
def test_chain_is_plotted_by_its_step_response_up_to_six_lags(
    taus_s: tuple[float, ...],
) -> None:
    step, response, lag = pictures.draw_chain(Chain(taus_s), axes()).lines
    t, y = points_of(response).T
    # rows are 0.02 s
    assert t[0] == pytest.approx(-0.6, abs=0.03)
    assert t[-1] == pytest.approx(12.0, abs=0.03)
    assert points_of(step)[:, 1] == pytest.approx((t > -1e-9).astype(float))
    time_since_step = np.maximum(t, 0.0)
    if len(taus_s) == 1:
        expected = 1 - np.exp(-time_since_step / 2.0)
    else:
        expected = 1 - (
            1.5 * np.exp(-time_since_step / 1.5) - 0.5 * np.exp(-time_since_step / 0.5)
        ) / (1.5 - 0.5)
    assert y == pytest.approx(expected, abs=0.012)  # a row of 0.02 s at 0.5/s
    assert lag.get_xdata()[0] == pytest.approx(2.0)  # type: ignore[index]
    assert lag.get_label() == "lag 2 s"


def test_labels_above_a_figure_use_rows_that_keep_them_apart() -> None:
    ax = axes()
    name_points(ax, [10.0, 10.2, 20.0], ["A1", "A2", "B1"])
    assert ax.get_xlim() == pytest.approx((9.4, 20.6))  # six hundredths of the span on either side
    texts = {t.get_text(): t for t in ax.texts if isinstance(t, Annotation)}
    assert [texts[n].xyann for n in ("A1", "A2", "B1")] == [(0, 3), (0, 13), (0, 3)]
    assert sorted(line.get_xdata()[0] for line in ax.lines) == [10.0, 10.2, 20.0]  # type: ignore[index]
    single_axes = axes()
    name_points(single_axes, [50.0], ["A1"])
    assert single_axes.get_xlim() == pytest.approx((45.0, 55.0))
    # a label takes 0.013 of the width for each letter plus 0.006: 0.032; the data span is 0.893
    pair_axes = axes()
    for gap, second in ((0.035, 13), (0.037, 3)):
        pair_axes.clear()
        name_points(pair_axes, [0.0, gap, 1.0], ["A1", "A2", "B1"])
        offsets = {t.get_text(): t.xyann[1] for t in pair_axes.texts if isinstance(t, Annotation)}
        assert offsets["A2"] == second


def test_axes_of_the_inverse_check_contain_all_marks_and_two_standard_deviations() -> None:
    table = pd.DataFrame(
        {"disk": ["fast", "slow"], "quantity": ["beta", "h_W_m2K"], "z": [-5.0, 0.5]}
    )
    ax = draw_inverse_check(table, axes())
    assert [points_of(line)[0].tolist() for line in ax.lines[:2]] == [[-5.0, 1.0], [0.5, 0.0]]
    assert [t.get_text() for t in ax.get_yticklabels()] == ["fast β", "slow h"]
    assert ax.get_xlim() == pytest.approx((-6.0, 6.0))
    assert ax.get_ylim() == pytest.approx((-0.6, 1.6))
    assert draw_inverse_check(table.assign(z=0.1), axes()).get_xlim() == (-3.0, 3.0)
    (band,) = ax.patches
    assert band.get_extents().transformed(ax.transData.inverted()).intervalx == pytest.approx(
        [-2.0, 2.0]
    )


def test_compensated_trace_is_plotted_with_band_flags_and_events_in_the_window() -> None:
    t = np.arange(12_000) / 10
    flags = np.zeros((12_000, 2), dtype=int)
    flags[[3000, 9000, 9003], 1] = 1
    y = np.column_stack([t, 2 * t])
    y[9003] = np.nan
    result: Any = SimpleNamespace(
        time_s=t,
        temperature=np.column_stack([t, 2 * t + 5]),
        sd=np.full((12_000, 2), 0.5),
        units=(),
        flags=flags,
        events_s=((500.0, "load"), (900.0, "parting"), (1100.0, "stop")),
    )
    ax = draw_compensated(result, y, axes(), channel=1, window_s=(300.0, 1000.0))
    logged, compensated, flagged, event, last_event = ax.lines
    x = points_of(compensated)[:, 0]
    assert len(x) == 4000
    assert (x[0], x[-1]) == pytest.approx((300.0, 1000.0))
    assert points_of(compensated)[:, 1] == pytest.approx(2 * x + 5)
    logged_s, readings = points_of(logged).T
    assert np.nanmax(np.abs(readings - 2 * logged_s)) < 1e-9
    assert points_of(flagged) == pytest.approx(np.array([[300.0, 600.0], [900.0, 1800.0]]))
    assert [event.get_xdata()[0], last_event.get_xdata()[0]] == [500.0, 900.0]  # type: ignore[index]
    (band,) = ax.collections
    assert band.get_datalim(ax.transData).intervaly == pytest.approx(
        [605 - Z95 / 2, 2005 + Z95 / 2]
    )
    full_line = draw_compensated(result, None, axes()).lines[0]
    assert points_of(full_line)[[0, -1], 0] == pytest.approx(t[[0, -1]])


def test_step_response_of_a_filter_report_is_plotted_for_at_most_eight_rise_times() -> None:
    t = np.linspace(0.0, 100.0, 11)
    report: Any = SimpleNamespace(
        step_time_s=t,
        raw_step=t / 100,
        step=t / 50,
        raw_rise_s=2.0,
        rise_s=0.5,
        remaining_shift_s=0.125,
        noise_gain=3.0,
    )
    assert draw_filter_report(report, axes()).get_xlim() == (0.0, 16.0)
    report.raw_rise_s = 20.0
    assert draw_filter_report(report, axes()).get_xlim() == (0.0, 100.0)
