"""Tables of one test as text: estimates, budget, conditions, junctions, intervals.

Used by ``BetaRun`` and by the report of a test. Guarded by ``tests/partition/test_structures.py``
and ``tests/report/test_beta_page.py``.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import pandas as pd

from tcdyn.core.estimate import Estimate, text_with_u
from tcdyn.core.messages.partition import model_form_text
from tcdyn.core.messages.phrases import text_rounded_to_u
from tcdyn.core.messages.plunge import probability_text
from tcdyn.partition.analyse import Partition
from tcdyn.partition.crosscheck import BudgetRow
from tcdyn.partition.joint_results import compare_joint_fit, joint_budget, oil_film_share
from tcdyn.partition.model_forms import ModelForms
from tcdyn.partition.profile import intervals
from tcdyn.partition.sensor_faults import DepthTest
from tcdyn.rig.disk import DISKS, LEFT_OUT_TEXT


def residuals_table(partition: Partition) -> pd.DataFrame:
    """Table of reading minus model [mK]: mean under load, mean after unloading, rms over noise."""
    rows = []
    for disk in partition.disks:
        m = compare_joint_fit(partition, disk)
        difference = m.readings_degC - m.model_degC
        after = m.time_since_unloading_s > 0
        for k, c in enumerate(m.channels):
            if np.isnan(difference[:, k]).any():
                rows.append((disk, c, LEFT_OUT_TEXT, "", ""))
                continue
            before, cooling = (
                f"{1e3 * float(np.mean(difference[rows_of_part, k])):+z.0f}"
                for rows_of_part in (~after, after)
            )
            rms = float(np.sqrt(np.mean((difference[:, k] / m.sd_K[:, k]) ** 2)))
            rows.append((disk, c, before, cooling, f"{rms:.2f}"))
    columns = [
        "disk",
        "junction",
        "mean under load [mK]",
        "mean after the unloading [mK]",
        "rms over noise [1]",
    ]
    return pd.DataFrame(rows, columns=columns)


# headings and axis labels of the parameters of the joint fit
COLUMN_HEADINGS = {
    "beta": "β [1]",
    "h": "h [W/m²K]",
    "lag_s": "lag [s]",
    "h_fast": "h, fast [W/m²K]",
    "h_slow": "h, slow [W/m²K]",
    "exponent": "exponent n [1]",
}


def estimate_row(
    word: str,
    beta: Estimate,
    h: Estimate | None = None,
    lag: Estimate | None = None,
    n: Estimate | None = None,
    reported: bool = True,
) -> dict[str, str]:
    """One row of a table of estimates, empty where the estimate is withheld.

    Parameters
    ----------
    word
        Name of the method.
    beta, h, lag, n
        Estimates [1], [W/m2K], [s] and [1]; None for an empty cell.
    reported
        False for an estimate that is withheld.
    """
    row = {"way": word, "β [1]": beta.text_without_interval(), "95 % of β": beta.interval_text}
    more = {"h [W/m²K]": h, "lag [s]": lag, "exponent n [1]": n}
    row |= {key: e.text_without_interval() if e else "" for key, e in more.items()}
    return row if reported else {**dict.fromkeys(row, ""), "way": word, "β [1]": "withheld"}


def estimates_table(partition: Partition, truth: float | None = None) -> pd.DataFrame:
    """beta, h, lag and exponent by every method, the recommended one first.

    Cells have standard uncertainties, beta its 95 % interval as well. With the ``truth`` of a
    simulation the last two rows are the recommended estimate and the truth.
    """
    answers = partition.estimates
    withheld = partition.impossible
    rows = []
    if not partition.single_disk:
        both = partition.combined.estimates
        n = None if "both exponent" in withheld else both["exponent"]
        for d in DISKS:
            beta = both["beta"]
            word = f"joint fit of both, {d} disk"
            reported = "both beta" not in withheld
            rows.append(estimate_row(word, beta, both[f"h_{d}"], n=n, reported=reported))
        for d in DISKS:
            beta = answers["speed law"]
            word = f"speed law, {d} disk"
            reported = "speed law" not in withheld
            rows.append(estimate_row(word, beta, answers[f"h_{d}"], reported=reported))
    for kind in ("cooling", "joint"):
        for d, fit in partition.joint.items():
            key = f"{kind} {d}"
            rows.append(
                estimate_row(
                    f"{kind} fit, {d} disk",
                    answers[key],
                    answers[f"h {key}"],
                    fit.estimates["lag_s"] if kind == "joint" else None,
                    reported=key not in withheld,
                )
            )
    if truth is not None:
        best = partition.combined.estimates["beta"]
        rows.append(estimate_row("recommended", best, reported=partition.status != "withheld"))
        rows.append({"way": "truth of the simulation", "β [1]": f"{truth:.4f}"})
    table = pd.DataFrame(rows).fillna("")
    return table.drop(columns="exponent n [1]") if partition.single_disk else table


def model_forms_table(forms: ModelForms) -> pd.DataFrame:
    """Table of the fit of both disks with every other model form, best supported first."""
    rows = []
    for a, likely in zip(forms.forms, forms.probability):
        implied = a.exponent.text_without_interval()
        rows.append(
            (
                model_form_text(a.name),
                a.beta.text_without_interval(),
                f"{a.delta_chi2:.1f}",
                probability_text(likely),
                implied,
            )
        )
    columns = ["if", "β [1]", "chi-squared falls by [1]", "probability", "exponent n [1]"]
    return pd.DataFrame(rows, columns=columns)


def budget_table(partition: Partition) -> pd.DataFrame:
    """Table of the uncertainty of beta by source and method, largest first.

    The columns are the combined fit (recommended), the speed law, which needs both disks, and the
    cooling fit; the last row is the total.

    Notes
    -----
    The heat that the oil film carries away (appendix B) enters neither disk, like a friction that
    is read too high by this share. It is not corrected; its line is its effect on beta.
    """
    recommended = joint_budget(partition)
    by_source = {row.source: row for row in partition.budget.rows}
    rows = {}
    for source in sorted(recommended | by_source, key=lambda x: -recommended.get(x, 0.0)):
        row = by_source.get(source, BudgetRow(source, 0.0, 0.0))
        u_recommended = recommended.get(source, 0.0)
        rows[source] = np.array([u_recommended, row.u_beta_steady, row.u_beta_transient], float)
    total = partition.budget.total
    u_total = sum(u**2 for u in recommended.values()) ** 0.5
    total_u = np.array([u_total, total.u_beta_steady, total.u_beta_transient], dtype=float)
    friction_rel = partition.test.disks[partition.disks[0]].uncertainty.friction_rel
    if "friction" in rows and friction_rel > 0:
        rows["oil film"] = oil_film_share(partition) / friction_rel * rows["friction"]
        total_u = np.hypot(total_u, rows["oil film"])
    rows[total.source] = total_u
    if partition.single_disk:
        heads = ("joint fit", "speed law", "cooling fit")
    else:
        heads = ("fit of both disks", "speed law", "cooling fit of the worse disk")
    columns = [f"u(β) [1], {head}" for head in heads]
    frame = pd.DataFrame.from_dict(rows, orient="index", columns=columns)
    # the speed law has no numbers in a test with one disk
    return frame.dropna(axis="columns").map(u_beta_text).rename_axis("source").reset_index()


def u_beta_text(u: float) -> str:
    """A standard uncertainty of beta [1] with four decimals; smaller ones are "below 0.0001"."""
    return f"{u:.4f}" if u >= 0.5e-4 else "below 0.0001"


def conditions_table(partition: Partition) -> pd.DataFrame:
    """Table of load, speeds, friction, events and hottest surfaces of the test, with units."""
    t = partition.test
    plain = [
        ("load", f"{t.load_N:.0f}", "N"),
        ("friction", f"{t.friction_N:.2f}", "N"),
        ("friction coefficient", f"{t.friction_N / t.load_N:.4f}", "1"),
        ("sliding speed", f"{t.sliding_speed_m_s:.2f}", "m/s"),
        ("entraining speed", f"{t.entraining_speed_m_s:.2f}", "m/s"),
        (
            "frictional heat that leaves with the oil film",
            f"{100 * oil_film_share(partition):.2f}",
            "%",
        ),
        ("half-width of the contact", f"{t.half_width_m * 1e3:.3f}", "mm"),
        ("load on at", f"{t.events.load_on_s:.2f}", "s"),
        ("unloading at", text_with_u(t.events.unload_s, t.events.unload_u_s), "s"),
    ]
    for word, key, unit in (
        ("hottest surface, fast disk", "surface fast", "°C"),
        ("hottest surface, slow disk", "surface slow", "°C"),
        ("their difference times sliding speed, ΔT u_s", "delta_T_us", "K m/s"),
    ):
        plain += [(word, str(partition.estimates[key]), unit)] if key in partition.estimates else []
    return pd.DataFrame(plain, columns=["quantity", "value", "unit"])


def junctions_table(tests: Mapping[str, DepthTest]) -> pd.DataFrame:
    """Table of the depth of each junction by the test itself against the nominal one.

    Parameters
    ----------
    tests
        Test of the depths by disk.

    Returns
    -------
    DataFrame
        Estimated difference of the depth [mm], uncertainty of the nominal depth [mm], and
        departure from the nominal depth in standard deviations.
    """
    rows = []
    for disk, test in tests.items():
        for (channel, deeper), pull in zip(test.deeper_m.items(), test.pull):
            mm = deeper.scaled(1e3).text_without_interval()
            rows.append(
                (
                    disk,
                    channel,
                    mm,
                    f"{1e3 * test.nominal_u_m:.2f}",
                    f"{round(float(pull), 1) + 0.0:+.1f}",
                )
            )
        rows += [(disk, channel, LEFT_OUT_TEXT, "", "") for channel in test.excluded]
    columns = [
        "disk",
        "junction",
        "deeper than stated [mm]",
        "u of the stated depth [mm]",
        "standard deviations off [1]",
    ]
    return pd.DataFrame(rows, columns=columns)


def interval_table(profiles: pd.DataFrame) -> pd.DataFrame:
    """Table of every parameter of the joint fits with both 95 % intervals, and a remark.

    The remark says where the normal and the profile interval differ.
    """
    rows = []
    for i in intervals(profiles):
        e = i.estimate
        rows.append(
            {
                "joint fit": "both disks" if i.fit == "both" else f"{i.fit} disk",
                "number": COLUMN_HEADINGS[i.parameter],
                "value": str(e),
                "95 %, normal": " to ".join(
                    text_rounded_to_u(end, e.u) for end in (e.low95, e.high95)
                ),
                "95 %, profile": " to ".join(
                    text_rounded_to_u(end, e.u) for end in (i.low95, i.high95)
                ),
                "remark": i.sentence,
            }
        )
    return pd.DataFrame(rows)
