"""Results of one test: beta.json, and tables of estimates, budget, conditions, cooling window.

Used by the workflows of ``beta``, by ``tcdyn.plots`` and ``tcdyn.report``. Keys and columns are
read by other programs and by ``tcdyn.workflows.campaign_table``: a new one is described in
docs/files.md, and a test compares them. Guarded by ``tests/partition/test_windows.py``,
``tests/partition/test_structures.py`` and ``tests/report/test_beta_page.py``.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
import pandas as pd

from immersion.fluids import fluid
from tcdyn.core import Array
from tcdyn.core.errors import InputError
from tcdyn.core.estimate import Estimate, text_with_u
from tcdyn.core.messages.partition import model_form_text
from tcdyn.core.messages.phrases import text_rounded_to_u
from tcdyn.core.messages.plunge import probability_text
from tcdyn.partition.analyse import Partition
from tcdyn.partition.cooling import (
    compensate_disk,
    cooling_effects,
    cooling_fit,
    cooling_sensitivity,
    smooth_traces,
)
from tcdyn.partition.crosscheck import BudgetRow
from tcdyn.partition.film_heat import film_heat_share
from tcdyn.partition.joint import SHARE, main_covariance, nuisance_parameters
from tcdyn.partition.model_forms import ModelForms
from tcdyn.partition.profile import intervals, profiles_file
from tcdyn.partition.sensor_check import SensorCheck
from tcdyn.partition.sensor_faults import DepthTest
from tcdyn.partition.specified import log_h_prior
from tcdyn.partition.window import fit_rows, rows_between
from tcdyn.rig.disk import DISKS, LEFT_OUT_TEXT


@dataclass(frozen=True)
class FitComparison:
    """Readings of one disk's outer row against the joint fit.

    Attributes
    ----------
    channels
        The M channels of the outer row.
    time_since_unloading_s
        Time since the unloading, shape (R,).
    readings_degC, model_degC, sd_K
        Readings [degC], model [degC] and standard deviation of a reading [K], shape (R, M); NaN
        for a channel that is left out.
    """

    channels: tuple[str, ...]
    time_since_unloading_s: Array
    readings_degC: Array
    model_degC: Array
    sd_K: Array


def compare_joint_fit(p: Partition, disk: str) -> FitComparison:
    """Compare readings and model of a disk at the optimum of the joint fit of all its disks.

    Parameters
    ----------
    p
        The partition.
    disk
        Name of the disk.

    Notes
    -----
    The residuals of the optimum start with those of the readings, disk by disk in the order of
    ``tcdyn.rig.disk.DISKS``; this must stay the order of ``tcdyn.partition.joint``.
    """
    blocks = [fit.block for fit in p.joint.values()]
    index = p.disks.index(disk)
    ends = np.cumsum([len(block.y) for block in blocks])
    window = blocks[index].window
    residuals = np.split(p.combined.optimum.residual[: ends[-1]], ends[:-1])
    residual = residuals[index].reshape(window.y.shape)
    sd = 1 / np.where(window.weight > 0, window.weight, np.nan)
    return FitComparison(
        p.test.disks[disk].setup.outer,
        window.block_time_s - p.test.events.unload_s,
        window.y,
        window.y + residual * sd,
        sd,
    )


def residuals_table(p: Partition) -> pd.DataFrame:
    """Table of reading minus model [mK]: mean under load, mean after unloading, rms over noise."""
    rows = []
    for disk in p.disks:
        m = compare_joint_fit(p, disk)
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


def joint_budget(p: Partition) -> dict[str, float]:
    """Standard uncertainty of the recommended beta by source, largest first; squares add up.

    Parameters
    ----------
    p
        The partition.

    Returns
    -------
    dict
        Standard uncertainty [1] by source.

    Notes
    -----
    The order of the sources is that of the columns of ``tcdyn.partition.joint.main_covariance``:
    nuisance parameters, two of the chain for each disk, and the measured surface flux if there are
    more. Noise is scaled by the inflation factor of the fit.
    """
    blocks = [fit.block for fit in p.joint.values()]
    noise, per_sd = main_covariance(p.combined.optimum, blocks)
    sources = [nuisance.source for nuisance, _ in nuisance_parameters(blocks)]
    sources += ["chain"] * (2 * len(blocks))
    sources += ["measured surface flux"] * (per_sd.shape[1] - len(sources))
    square = {"noise": p.combined.inflation * float(noise[SHARE, SHARE])}
    for source, by in zip(sources, per_sd[SHARE]):
        square[source] = square.get(source, 0.0) + float(by) ** 2
    return {source: x**0.5 for source, x in sorted(square.items(), key=lambda item: -item[1])}


SCHEMA = "tcdyn.beta/1"  # of beta.json; it changes with the meaning of a key
WITHHELD: dict[str, Any] = dict.fromkeys(
    ("value", "u", "low95", "high95")
)  # an estimate that is withheld
# headings and axis labels of the parameters of the joint fit
COLUMN_HEADINGS = {
    "beta": "β [1]",
    "h": "h [W/m²K]",
    "lag_s": "lag [s]",
    "h_fast": "h, fast [W/m²K]",
    "h_slow": "h, slow [W/m²K]",
    "exponent": "exponent n [1]",
}
# window lengths [s] of ``cooling_by_window``; chosen by judgement
WINDOW_LENGTHS_S = (0.5, 0.75, 1.0, 1.5, 2.0, 3.0, 5.0, 7.5, 10.0, 15.0, 20.0)
OIL_WINDOW_S = 20.0  # before the unloading, for the temperature of the oil film; by judgement
TWO_SIGMA = 2.0  # two estimates agree below so many standard uncertainties of their difference


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


def structures_table(forms: ModelForms) -> pd.DataFrame:
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


def budget_table(p: Partition) -> pd.DataFrame:
    """Table of the uncertainty of beta by source and method, largest first.

    The columns are the combined fit (recommended), the speed law, which needs both disks, and the
    cooling fit; the last row is the total.

    Notes
    -----
    The heat that the oil film carries away (appendix B) enters neither disk, like a friction that
    is read too high by this share. It is not corrected; its line is its effect on beta.
    """
    recommended = joint_budget(p)
    by_source = {row.source: row for row in p.budget.rows}
    rows = {}
    for source in sorted(recommended | by_source, key=lambda x: -recommended.get(x, 0.0)):
        row = by_source.get(source, BudgetRow(source, 0.0, 0.0))
        u_recommended = recommended.get(source, 0.0)
        rows[source] = np.array([u_recommended, row.u_beta_steady, row.u_beta_transient], float)
    total = p.budget.total
    u_total = sum(u**2 for u in recommended.values()) ** 0.5
    total_u = np.array([u_total, total.u_beta_steady, total.u_beta_transient], dtype=float)
    friction_rel = p.test.disks[p.disks[0]].uncertainty.friction_rel
    if "friction" in rows and friction_rel > 0:
        rows["oil film"] = oil_film_share(p) / friction_rel * rows["friction"]
        total_u = np.hypot(total_u, rows["oil film"])
    rows[total.source] = total_u
    if p.single_disk:
        heads = ("joint fit", "speed law", "cooling fit")
    else:
        heads = ("fit of both disks", "speed law", "cooling fit of the worse disk")
    columns = [f"u(β) [1], {head}" for head in heads]
    frame = pd.DataFrame.from_dict(rows, orient="index", columns=columns)
    # the speed law has no numbers in a test with one disk
    return frame.dropna(axis="columns").map(u_of_beta).rename_axis("source").reset_index()


def oil_film_share(p: Partition) -> float:
    """Share of the frictional heat that leaves with the oil film, assumed to be Mobil Jet Oil II.

    The oil has the mean temperature of the junctions in the last seconds under load.

    Parameters
    ----------
    p
        Result of one test.
    """
    test = p.test
    rows = rows_between(test.time_s, test.events.unload_s - OIL_WINDOW_S, test.events.unload_s)
    disks = list(test.disks.values())
    bulk_degC = np.mean([np.nanmean(disk.readings_degC[rows]) for disk in disks])
    setup = disks[0].setup
    return film_heat_share(
        test.load_N,
        test.friction_N,
        test.sliding_speed_m_s,
        test.entraining_speed_m_s,
        fluid("mobil-jet-ii").at(bulk_degC),
        setup.outer_radius_m,
        setup.crown_radius_m,
    )


def u_of_beta(u: float) -> str:
    """A standard uncertainty of beta in a table."""
    return f"{u:.4f}" if u >= 0.00005 else "below 0.0001"


def conditions_table(p: Partition) -> pd.DataFrame:
    """Table of the conditions of the test."""
    t = p.test
    plain = [
        ("load", f"{t.load_N:.0f}", "N"),
        ("friction", f"{t.friction_N:.2f}", "N"),
        ("friction coefficient", f"{t.friction_N / t.load_N:.4f}", "1"),
        ("sliding speed", f"{t.sliding_speed_m_s:.2f}", "m/s"),
        ("entraining speed", f"{t.entraining_speed_m_s:.2f}", "m/s"),
        ("frictional heat that leaves with the oil film", f"{100 * oil_film_share(p):.2f}", "%"),
        ("half-width of the contact", f"{t.half_width_m * 1e3:.3f}", "mm"),
        ("load on at", f"{t.events.load_on_s:.2f}", "s"),
        ("unloading at", text_with_u(t.events.unload_s, t.events.unload_u_s), "s"),
    ]
    for word, key, unit in (
        ("hottest surface, fast disk", "surface fast", "°C"),
        ("hottest surface, slow disk", "surface slow", "°C"),
        ("their difference times sliding speed, ΔT u_s", "delta_T_us", "K m/s"),
    ):
        plain += [(word, str(p.estimates[key]), unit)] if key in p.estimates else []
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


def cooling_by_window(
    partition: Partition, lengths: Sequence[float] = WINDOW_LENGTHS_S
) -> pd.DataFrame:
    """Table of the h-only fit of each disk for each window length.

    Parameters
    ----------
    partition
        The partition.
    lengths
        Window lengths [s]; those beyond the end of the log are left out.

    Returns
    -------
    DataFrame
        Columns disk, window_s, within_lag, beta, u_beta, h_W_m2K, u_h_W_m2K and misfit_K. NaN where
        a fit fails.

    Raises
    ------
    InputError
        If no length is left, or one is not above zero.

    Notes
    -----
    Traces are smoothed as freely as for the cooling fit. ``u_beta`` and ``u_h_W_m2K`` include
    noise, nuisance parameters, the steady line and the lag. The lag counts as independent; the
    budget draws it with the correlations of the joint fit. ``within_lag`` marks windows shorter
    than the common lag of the disk, which depend more on the chain than on the cooling. The lengths
    may be changed freely. Guarded by ``tests/partition/test_windows.py``:
    ``test_window_of_five_seconds_reproduces_the_cooling_fit`` compares ``u_beta`` with the budget
    (within 20 %).
    """
    test = partition.test
    cooling_s = float(test.time_s[-1] - test.events.unload_s)
    if min(lengths, default=1.0) <= 0:
        raise InputError(f"a window of {min(lengths):g} s", expected="lengths above zero")
    lengths_s = sorted(float(x) for x in lengths if x <= cooling_s)
    if not lengths_s:
        raise InputError(
            f"the log holds {cooling_s:.2f} s of cooling",
            expected=f"at least {min(lengths, default=0):g} s",
        )
    fit_rows_slice = fit_rows(test, lengths_s[-1])
    of_disks = [
        _cooling_rows_of_disk(partition, disk, fit_rows_slice, lengths_s)
        for disk in partition.disks
    ]
    return pd.DataFrame([row for of_one in of_disks for row in of_one])


def _cooling_rows_of_disk(
    p: Partition, name: str, fit_rows_slice: slice, lengths: Sequence[float]
) -> list[dict[str, object]]:
    """Rows of ``cooling_by_window`` for one disk.

    Parameters
    ----------
    p
        The partition.
    name
        Name of the disk.
    fit_rows_slice
        Rows of the test that the longest window uses.
    lengths
        Window lengths [s].

    Returns
    -------
    list
        For each length disk, window_s [s], within_lag (whether the window is shorter than the
        common lag), beta and u_beta [1] (of the share of the fast disk), h_W_m2K and u_h_W_m2K
        [W/m2K], misfit_K [K]. The last five are NaN where the fit fails.

    Notes
    -----
    u^2 = sum per_sd^2 + noise + (u_lag by_lag)^2, by
    ``tcdyn.partition.cooling.cooling_sensitivity``; u_lag is that of the joint fit of the disk. The
    keys are the columns of :func:`cooling_by_window`, which
    ``tcdyn.plots.transient.draw_window_study`` reads; change both.
    """
    test = p.test
    line = p.lines[name]
    lag = p.joint[name].estimates["lag_s"]
    nominal = p.cooling[name]
    smoothed_traces = smooth_traces(
        test, test.disks[name], fit_rows_slice, p.chains[name], lag.u, p.compensated[name]
    )
    cooling_data = compensate_disk(
        test, test.disks[name], fit_rows_slice, smoothed_traces, p.windows[name].rim.profile
    )
    errors = cooling_effects(cooling_data, nominal.share, nominal.h_W_m2K)
    out: list[dict[str, object]] = []
    for length in lengths:
        fit_values = dict.fromkeys(("beta", "u_beta", "h_W_m2K", "u_h_W_m2K", "misfit_K"), np.nan)
        try:
            prior = log_h_prior(cooling_data.disk.setup.surface)
            fit = cooling_fit(
                cooling_data.window,
                line.line,
                test.events.unload_s,
                length,
                cooling_data.noise_K,
                prior,
            )
        except InputError:
            pass
        else:
            shift = cooling_sensitivity(fit, *errors, line)
            variance = (
                (shift.per_sd**2).sum(axis=0) + np.diag(shift.noise) + (lag.u * shift.by_lag) ** 2
            )
            u_share, u_h = (float(u) for u in np.sqrt(variance))
            fit_values = {
                "beta": fit.beta,
                "u_beta": u_share,
                "h_W_m2K": fit.h_W_m2K,
                "u_h_W_m2K": u_h,
                "misfit_K": fit.misfit_K,
            }
        out.append(
            {"disk": name, "window_s": length, "within_lag": length < lag.value, **fit_values}
        )
    return out


def reference_table(partition: Partition) -> pd.DataFrame:
    """Compare the cooling fit and the joint fit of each disk for beta and h.

    The first fits compensated temperatures, the second applies the chain to the model, without an
    inverse.

    Parameters
    ----------
    partition
        The partition.

    Returns
    -------
    DataFrame
        ``u_difference`` is the standard deviation of the difference of the Monte Carlo samples of
        the budget, so that errors common to both cancel; ``z`` = difference / u_difference;
        ``agree`` where abs(z) is below ``TWO_SIGMA``.
    """
    rows = []
    for d in partition.disks:
        for quantity, key in (("beta", ""), ("h_W_m2K", "h ")):
            ways = [f"{key}{kind} {d}" for kind in ("cooling", "joint")]
            compensated_value, commuted_value = (partition.estimates[way] for way in ways)
            a, b = (partition.budget.samples[way] for way in ways)
            difference = compensated_value.value - commuted_value.value
            u = float(np.std(a - b))
            z = difference / max(u, 1e-12)
            rows.append(
                {
                    "disk": d,
                    "quantity": quantity,
                    "compensated": compensated_value.value,
                    "u_compensated": compensated_value.u,
                    "commuted": commuted_value.value,
                    "u_commuted": commuted_value.u,
                    "difference": difference,
                    "u_difference": u,
                    "correlation": float(np.corrcoef(a, b)[0, 1]),
                    "z": z,
                    "agree": bool(abs(z) < TWO_SIGMA),
                }
            )
    return pd.DataFrame(rows)


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


def beta_file(p: Partition, source: dict[str, str], with_profiles: bool = False) -> dict[str, Any]:
    """The content of ``beta.json`` without sufficient statistics and checksum.

    Parameters
    ----------
    p
        The partition.
    source
        Name and SHA-256 of the log.
    with_profiles
        Whether to compute the likelihood profiles of the joint fits; otherwise ``profiles`` is
        empty.

    Returns
    -------
    dict
        Every estimate is {value, u, low95, high95}, null where it is withheld or needs a disk that
        was not logged; h in W/m2K, lags in s, depths of junctions in mm.

    Notes
    -----
    ``SCHEMA`` changes with the meaning of a key. ``tcdyn.workflows.campaign_table.COLUMNS`` uses
    the same keys.
    """
    test = p.test
    forms = p.model_forms
    is_withheld = p.status == "withheld"
    recommended = joint_budget(p)
    recommended_beta = _reported(p, p.combined.estimates, "beta", "both ")
    range95 = None
    alternatives = []
    if forms is not None and not is_withheld:
        range95 = [forms.low95, forms.high95]
        alternatives = forms.to_list()
    steady = {key: _reported(p, p.estimates, key) for key in ("h_fast", "h_slow", "exponent")}
    for d in p.disks:
        steady[f"{d}_line"] = {
            key: _reported(p, p.estimates, f"{d} {key}") for key in ("intercept", "slope")
        }
    joint: dict[str, Any] = {}
    for d, fit in p.joint.items():
        lag = fit.estimates["lag_s"].model_dump()
        joint[d] = {
            "beta": _reported(p, p.estimates, f"joint {d}"),
            "h": _reported(p, p.estimates, f"h joint {d}"),
            "lag_s": WITHHELD if f"joint {d}" in p.impossible else lag,
        }
    both = {} if p.single_disk else p.combined.estimates
    joint["both"] = {
        key: _reported(p, both, key, "both ") for key in ("beta", "h_fast", "h_slow", "exponent")
    }
    joint["profiles"] = profiles_file(p.profiles) if with_profiles else {}
    return {
        "schema": SCHEMA,
        "source": source,
        "test": test.conditions,
        "steady": {"beta": _reported(p, p.estimates, "speed law"), **steady},
        "transient": {
            d: {
                "beta": _reported(p, p.estimates, f"cooling {d}"),
                "h": _reported(p, p.estimates, f"h cooling {d}"),
                "window_s": fit.window_s,
            }
            for d, fit in p.cooling.items()
        },
        "joint": joint,
        "headline": {
            "beta": recommended_beta,
            "way": f"joint {p.single_disk or 'both'}",
            "sentence": p.recommendation.sentence,
            "range95": range95,
        },
        "status": p.status,
        "alternatives": alternatives,
        "crosscheck": p.crosscheck.to_dict(),
        "budget": [asdict(row) for row in p.budget.rows],
        "budget_both": [{"source": name, "u_beta": u} for name, u in recommended.items()],
        "surface": {
            "fast_max_degC": _reported(p, p.estimates, "surface fast"),
            "slow_max_degC": _reported(p, p.estimates, "surface slow"),
            "delta_T_us": _reported(p, p.estimates, "delta_T_us"),
        },
        "noise": {d: disk.noise.to_dict() for d, disk in test.disks.items()},
        "unevenness": {d: harmonic.to_dict() for d, harmonic in p.combined.harmonics.items()},
        "sensors": {} if p.sensors is None else p.sensors.texts,
        "junctions": junction_depths(p.sensors),
        "findings": [finding.to_dict() for finding in p.findings],
        "warnings": list(p.warnings),
    }


def _reported(
    p: Partition, estimates: Mapping[str, Estimate], key: str, prefix: str = ""
) -> dict[str, Any]:
    """An estimate as in ``beta.json``; nulls where it is withheld or missing.

    Parameters
    ----------
    p
        The partition.
    estimates
        ``p.estimates``, or those of the combined fit.
    key
        Key of the estimate.
    prefix
        Prefix of the key in ``p.impossible``.
    """
    if key not in estimates or f"{prefix}{key}" in p.impossible:
        return WITHHELD
    return estimates[key].model_dump()


def junction_depths(sensor_check: SensorCheck | None) -> dict[str, Any]:
    """Depth of each junction by the test itself, as in ``beta.json``; empty without a sensor check.

    ``deeper_mm`` is the difference from the nominal depth, ``z`` the departure in standard
    deviations, see ``tcdyn.partition.sensor_faults.DepthTest``.
    """
    return {
        d: {
            c: {"deeper_mm": e.scaled(1e3).model_dump(), "z": float(z)}
            for (c, e), z in zip(t.deeper_m.items(), t.pull)
        }
        for d, t in ({} if sensor_check is None else sensor_check.depths).items()
    }
