"""The page and pictures of many tests: names that do not cover each other, lines only where three points make one."""

from __future__ import annotations

from itertools import combinations
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.backends.backend_agg import FigureCanvasAgg

from tcdyn.pipeline.campaign_table import table_columns
from tcdyn.plots import campaign as draw
from tcdyn.plots.style import figure
from tcdyn.report.campaign import beta_trend_words, campaign_pictures, partition_table, trend_words
from tcdyn.report.page import table_html

NAMES = [f"{family}{k}" for family in "ABCD" for k in range(1, 5)]


def sixteen(close: float = 1.0) -> pd.DataFrame:
    """The thesis's programme: four loads at four speeds; dT u_s within ``close`` of each other's spread."""
    rows = []
    for k, name in enumerate(NAMES):
        row: dict[str, Any] = dict.fromkeys(table_columns(), 0.1)
        load, speed = (850.0, 1460.0, 1850.0, 2320.0)[k % 4], (10.0, 13.0, 16.0, 20.0)[k // 4]
        row |= {"test": name, "error": "", "agree": "yes", "load_N": load, "sliding_speed_m_s": speed}
        row |= {"delta_T_us_K_m_s": 400 + close * load * speed / 40, "u_delta_T_us_K_m_s": 3.0}
        row |= {"beta": 0.75 - 1e-4 * load * speed / 40, "u_beta": 0.01, "friction_N": 0.01 * load + 0.1 * speed}
        rows.append(row)
    return pd.DataFrame(rows, columns=table_columns())


def test_names_of_tests_do_not_cover_each_other() -> None:
    for close in (1.0, 0.05):
        fig, (ax,) = figure(height_in=4.4)
        draw.draw_beta(sixteen(close), ax)
        canvas = FigureCanvasAgg(fig)
        canvas.draw()
        boxes = [t.get_window_extent(canvas.get_renderer()) for t in ax.texts]
        assert sorted(t.get_text() for t in ax.texts) == sorted(NAMES)
        assert not [1 for one, two in combinations(boxes, 2) if one.overlaps(two)]
        assert all(box.y1 <= fig.bbox.y1 for box in boxes)


def test_two_tests_make_no_line_and_three_do() -> None:
    for count, lines in ((2, 0), (3, 1)):
        _, (ax,) = figure()
        table = sixteen().head(count)
        draw.draw_traction(table, ax)
        drawn = [line for line in ax.lines if len(line.get_xdata()) == 2 and line.get_linestyle() != "None"]
        assert len(drawn) == lines
        assert " ".join(trend_words(table).get("quantity", ())).count("traction force") == lines


def test_pictures_tell_groups_apart_without_colour() -> None:
    _, (ax,) = figure()
    draw.draw_traction(sixteen(), ax)
    handles = ax.get_legend().legend_handles
    looks = {(h.get_marker(), str(h.get_linestyle())) for h in handles}
    assert len(looks) == 4


def test_tables_speak_words_and_units_not_column_names() -> None:
    table = sixteen()
    everything = " ".join(table_html(shown) for shown in (trend_words(table), partition_table(table)))
    assert "_" not in everything.replace("ΔT u_s", "")
    assert "bulk temperature, fast disk [°C]" in everything
    assert partition_table(table).shape[1] <= 8  # more do not fit a printed page


def test_a_slope_is_claimed_only_where_its_interval_leaves_zero_out() -> None:
    table = sixteen()
    assert "β changes with ΔT u_s" in beta_trend_words(table)
    table["beta"] = 0.7 + 0.01 * np.tile([1.0, -1.0, -1.0, 1.0], 4)
    assert "do not show" in beta_trend_words(table)
    assert beta_trend_words(table.head(2)) == ""


def test_a_campaign_has_the_thesis_s_figures() -> None:
    sections = campaign_pictures(sixteen().head(4))
    assert [s.figure is not None for s in sections] == [True] * 4  # 7.18, 7.20, 6.17, and 6.33 with 6.34
    assert "running surfaces" in sections[0].text  # what dT u_s is
