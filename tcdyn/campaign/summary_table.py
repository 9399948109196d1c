"""Table of a campaign (tables 7.1 to 7.3), groups of equal sliding speed, trend lines, comparison.

Used by :mod:`tcdyn.workflows.campaign`, and by plots and pages of a campaign. ``COLUMNS`` names the
keys of ``tcdyn.partition.beta_file.beta_file``: change both together. Guarded by
``tests/cli/test_campaign_command.py`` and ``tests/core/test_results.py``.
"""

from __future__ import annotations

from collections.abc import Mapping
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from tcdyn.campaign.scatter_trend import (
    MIN_SET_POINTS,
    LineTrend,
    count_set_points,
    least_squares_trend,
)
from tcdyn.core import Array
from tcdyn.core.errors import InputError
from tcdyn.core.estimate import Z95, Estimate
from tcdyn.estimation.line_fit import fit_line
from tcdyn.io.read import read_numbers
from tcdyn.rig.disk import DISKS

# This finding has its own column in the table; ``table_row`` does not count it as a warning, and
# ``tcdyn.workflows.campaign.CampaignRun.findings`` leaves it out.
AGREE_CODE = "ways.agree"
# Sliding speeds within 5 % belong to one group. Chosen by judgement.
SAME_SPEED = 0.05
# column: (keys into beta.json, is an estimate with u)
COLUMNS: dict[str, tuple[tuple[str, ...], bool]] = {
    "load_N": (("test", "load_N"), False),
    "sliding_speed_m_s": (("test", "sliding_speed_m_s"), False),
    "entraining_speed_m_s": (("test", "entraining_speed_m_s"), False),
    "friction_N": (("test", "friction_N"), False),
    "friction_coefficient": (("campaign", "friction_coefficient"), False),
    "beta": (("steady", "beta"), True),
    "h_fast_W_m2K": (("steady", "h_fast"), True),
    "h_slow_W_m2K": (("steady", "h_slow"), True),
    **{
        f"{key}_cooling_{d}{unit}": (("transient", d, key), True)
        for d in DISKS
        for key, unit in (("beta", ""), ("h", "_W_m2K"))
    },
    **{
        f"{key}_joint_{d}{unit}": (("joint", d, name), True)
        for d in DISKS
        for key, name, unit in (("beta", "beta", ""), ("h", "h", "_W_m2K"), ("lag", "lag_s", "_s"))
    },
    "beta_both": (("joint", "both", "beta"), True),
    "h_fast_both_W_m2K": (("joint", "both", "h_fast"), True),
    "h_slow_both_W_m2K": (("joint", "both", "h_slow"), True),
    "exponent": (("joint", "both", "exponent"), True),
    **{f"{d}_surface_max_degC": (("surface", f"{d}_max_degC"), True) for d in DISKS},
    "delta_T_us_K_m_s": (("surface", "delta_T_us"), True),
    **{f"{d}_bulk_degC": (("campaign", "bulk_degC", d), False) for d in DISKS},
    **{f"{d}_a_degC": (("campaign", "steady_degC", d, "a"), False) for d in DISKS},
    "crosscheck_z": (("crosscheck", "z"), False),
}
# Quantities that the thesis plots over load or sliding speed (figures 6.17, 6.33 to 6.35 and 7.20).
QUANTITIES = {
    "fast_bulk_degC": "bulk temperature, fast disk [°C]",
    "slow_bulk_degC": "bulk temperature, slow disk [°C]",
    "fast_surface_max_degC": "hottest surface, fast disk [°C]",
    "slow_surface_max_degC": "hottest surface, slow disk [°C]",
    "friction_N": "traction force [N]",
    "friction_coefficient": "coefficient of friction [1]",
}


def table_columns() -> list[str]:
    """All columns of campaign.csv in their order.

    Each estimate is followed by its standard uncertainty u_...
    """
    out = ["test", "log"]
    for name, (_, estimate) in COLUMNS.items():
        out += [name, f"u_{name}"] if estimate else [name]
    return [*out, "agree", "status", "warnings", "error"]


def table_row(log: str, data: Mapping[str, Any] | None, error: str = "") -> dict[str, Any]:
    """One row of the table; numbers are NaN for a test that failed.

    Parameters
    ----------
    log
        Name of the test.
    data
        Content of its beta.json; None for a test that failed.
    error
        Message of the failure.
    """
    row: dict[str, Any] = dict.fromkeys(table_columns(), np.nan)
    row |= {
        "test": log.removeprefix("EHL_"),
        "log": log,
        "error": error,
        "agree": "",
        "status": "",
        "warnings": 0,
    }
    if data is None:
        return row
    for name, (keys, estimate) in COLUMNS.items():
        value: Any = (
            data if keys[0] in data or keys[0] != "campaign" else None
        )  # a beta.json of its own has none
        for key in keys if value is not None else ():
            value = value.get(key)  # a disk may have no junction a
        if estimate:
            row[name] = _number(value["value"])
            row[f"u_{name}"] = _number(value["u"])
        else:
            row[name] = _number(value)
    row["status"] = data["status"]
    row["agree"] = "yes" if data["crosscheck"]["agree"] else "no"
    row["warnings"] = sum(value["code"] != AGREE_CODE for value in data["findings"])
    return row


def _number(value: Any) -> Any:
    """A value of beta.json, NaN for null: a column without any number stays one of numbers."""
    return np.nan if value is None else value


def campaign_table(rows: list[dict[str, Any]]) -> pd.DataFrame:
    """The rows as a table with the columns in their order."""
    return pd.DataFrame(rows, columns=table_columns())


def speed_groups(sliding_speed_m_s: Array) -> NDArray[np.int64]:
    """Group (N,) of nearly equal sliding speed for each test (N,) [m/s], from 0 for the slowest.

    >>> speed_groups(np.array([10.0, 20.1, 10.2, 13.0])).tolist()
    [0, 2, 0, 1]
    """
    order = np.argsort(sliding_speed_m_s, kind="stable")
    ranked = sliding_speed_m_s[order]
    steps = np.concatenate([[0], np.cumsum(np.diff(ranked) > SAME_SPEED * ranked[:-1])])
    out = np.empty(len(order), dtype=np.int64)
    out[order] = steps
    return out


def analysed_rows(
    table: pd.DataFrame, compared: pd.DataFrame | None = None, by: str = "sliding_speed_m_s"
) -> pd.DataFrame:
    """The tests that were analysed, in groups of nearly equal sliding speed.

    Parameters
    ----------
    table
        Table of the campaign.
    compared
        Other tests, see :func:`read_compared`.
    by
        Column of the groups.

    Returns
    -------
    rows
        With the columns ``group``, from 0, and ``compared``, True for the other tests.
    """
    rows = table[table["error"] == ""].assign(compared=False)
    if compared is not None:
        rows = pd.concat([rows, compared.assign(compared=True)], ignore_index=True)
    return rows.assign(group=speed_groups(rows[by].to_numpy(dtype=float)))


def read_compared(path: str | Path) -> pd.DataFrame:
    """Read other tests to compare with those of a campaign, for example published ones.

    Parameters
    ----------
    path
        Table with load_N, sliding_speed_m_s and at least one of ``QUANTITIES``, such as the
        campaign.csv of another campaign. The coefficient of friction follows from the friction.

    Returns
    -------
    table
        These columns, and ``test`` with the name of the file.

    Raises
    ------
    InputError
        A missing column, or a cell without a number.
    """
    columns = read_numbers(path, ("load_N", "sliding_speed_m_s"), QUANTITIES)
    table = pd.DataFrame(columns).assign(test=Path(path).name)
    if "friction_N" in table:
        table["friction_coefficient"] = table["friction_N"] / table["load_N"]
    if QUANTITIES.keys().isdisjoint(table):
        expected = ", ".join(QUANTITIES)
        raise InputError("it has no quantity to compare", where=str(path), expected=expected)
    return table


def trend_table(table: pd.DataFrame) -> pd.DataFrame:
    """Fit straight lines of ``QUANTITIES`` over the load in each group of sliding speed.

    Parameters
    ----------
    table
        Table of the campaign, one row a test; tests that failed are left out.

    Returns
    -------
    DataFrame
        One row a line: its quantity, speed and number of tests, then the fields of ``LineTrend``.
        A group whose loads do not determine a line has no row.
    """
    good = analysed_rows(table)
    rows = []
    for column, (_, part) in product(QUANTITIES, good.groupby("group")):
        line = least_squares_trend(
            part["load_N"].to_numpy(dtype=float), part[column].to_numpy(dtype=float)
        )
        if line is not None:
            name = f"{part['sliding_speed_m_s'].mean():.1f} m/s"
            rows.append(
                {
                    "quantity": column,
                    "over": "load_N",
                    "tests": name,
                    "number": len(part),
                    **line._asdict(),
                }
            )
    return pd.DataFrame(rows, columns=["quantity", "over", "tests", "number", *LineTrend._fields])


def comparison_table(table: pd.DataFrame, compared: pd.DataFrame) -> pd.DataFrame:
    """Difference between other tests and those of a campaign at the same load (figure 6.35).

    Parameters
    ----------
    table
        Table of the campaign.
    compared
        The other tests, see :func:`read_compared`.

    Returns
    -------
    table
        Columns quantity, sliding_speed_m_s, n_tests, n_compared, mean (of the campaign), and
        ``difference``, an estimate of the other tests minus those of the campaign. One row for each
        quantity and sliding speed that both have, with three loads or more.

    Notes
    -----
    Two parallel least-squares lines over the load; the uncertainty is that of the scatter about
    them, without that of the gains of the transducers. ``tests/report/test_campaign_page.py``
    guards it.
    """
    rows = []
    grouped = analysed_rows(table, compared).groupby("group")
    for quantity, (_, group) in product(QUANTITIES, grouped):
        part = group.dropna(subset=[quantity]) if quantity in compared else group[:0]
        is_other = part["compared"].to_numpy(dtype=bool)
        load_N = part["load_N"].to_numpy(dtype=float)
        n_compared = int(is_other.sum())
        if (
            not 0 < n_compared < len(part)
            or count_set_points(load_N) < MIN_SET_POINTS
            or len(part) < 4
        ):
            continue
        fit = fit_line(load_N, part[quantity].to_numpy(dtype=float), groups=is_other.astype(int))
        difference = float(fit.intercepts[1] - fit.intercepts[0])
        contrast = np.array([0.0, -1.0, 1.0])
        u = float(np.sqrt(contrast @ fit.covariance @ contrast))
        half_width = Z95 * float(np.sqrt(contrast @ fit.covariance_95 @ contrast))
        estimate = Estimate(
            value=difference, u=u, low95=difference - half_width, high95=difference + half_width
        )
        rows.append(
            {
                "quantity": quantity,
                "sliding_speed_m_s": float(part.loc[~is_other, "sliding_speed_m_s"].mean()),
                "n_tests": len(part) - n_compared,
                "n_compared": n_compared,
                "mean": float(part.loc[~is_other, quantity].mean()),
                "difference": estimate,
            }
        )
    columns = ["quantity", "sliding_speed_m_s", "n_tests", "n_compared", "mean", "difference"]
    return pd.DataFrame(rows, columns=columns)
