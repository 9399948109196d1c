"""Messages about sensor files, the measurement of a lag, and tables compensated with them.

A function here makes the text of one finding whose wording depends on its numbers; its arguments
are the fields of the finding (see ``tcdyn.core.messages``). Wording may be changed freely; codes,
names of fields and what a message advises must fit the place that makes the finding.
``tests/core/test_findings.py`` checks that each code is made somewhere and each code that is made
has a message.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from tcdyn.core.estimate import text_with_u
from tcdyn.core.messages.phrases import Message, count_with_noun


def _carried_columns(columns: Sequence[str], **_: Any) -> str:
    """Message of ``sensor.carried``.

    ``columns`` are the columns without a sensor.
    """
    count = count_with_noun(len(columns), "column")
    return f"{count} without a sensor, copied as logged: {', '.join(columns)}"


def _unit_assumed(subject: str, count: int = 1, **_: Any) -> str:
    """Message of ``sensor.unit_assumed``.

    ``subject`` names all ``count`` columns.
    """
    if count == 1:
        return f"column {subject} states no unit: read as degrees Celsius"
    return f"columns {subject} state no unit: read as degrees Celsius"


def _noise_driving(subject: str, lags: int, **_: Any) -> str:
    """Message of ``sensor.noise_driving``.

    ``lags`` is the number of lags that the spectrum shows.
    """
    text = (
        f"{subject}: the lag is the sensor's if the fluid's own fluctuations are white; slower "
        "ones add their time"
    )
    if lags == 2:
        text += "; of the two lags found one may be the fluid's"
    return text


# What may explain a response beside lags, and what would tell
CAUSES = {
    "chain": "lags alone",
    "film": "a film that changes after the entry (hold the sensor still, in a steady stream)",
    "bath": "a bath that changes after the entry (stir, or use a larger bath)",
    "fin": "a stem that conducts (immerse deeper)",
    "slow": "a second, slower path (log until the reading has settled)",
}


def _undecided_causes(subject: str, causes: Sequence[str], **_: Any) -> str:
    """Message of ``sensor.causes``.

    ``causes`` are the explanations, the likeliest first.
    """
    listed = "; or ".join(CAUSES[name] for name in causes)
    return (
        f"{subject}: the record does not distinguish {listed}. The intervals include each, and "
        "their difference limits the result"
    )


def _touch_other(
    touch: int, time_s: float, column: str, stated: str, exchanged: bool, **_: Any
) -> str:
    """Message of ``touch.other``.

    ``touch`` is the number of the touch, ``column`` the one that responded. ``exchanged``: the
    stated column responded when this one was touched.
    """
    text = f"touch {touch} ({time_s:.1f} s): {column} responded, stated was {stated}"
    if exchanged:
        return f"{text}, and the other way round: the two are interchanged, or were touched so"
    return f"{text}: check the wiring and the order"


def _touch_silent(columns: Sequence[str], **_: Any) -> str:
    """Message of ``touch.silent``.

    ``columns`` are the columns that responded most to no touch.
    """
    return f"no touch after which {' or '.join(columns)} rose most"


def _dip_departs(
    subject: str,
    dip: str,
    lag_s: float,
    u_s: float,
    without_s: float,
    without_u_s: float,
    p_value: float,
    **_: Any,
) -> str:
    """Message of ``sensor.dip_departs``.

    ``dip`` is the file or the number of the dip, ``without_s`` the lag of one further dip without
    it, ``p_value`` that of its lag under the prediction of the others.
    """
    return (
        f"{subject}: the lag of {dip}, {text_with_u(lag_s, u_s, 's')}, departs from those of the "
        f"other dips (p = {p_value:.1g}). The result includes it; without {dip}: "
        f"{text_with_u(without_s, without_u_s, 's')}. Look at its record, and give the others only "
        "if you find a cause"
    )


def _history_changed(
    subject: str,
    group: str,
    percent: float,
    u_percent: float,
    days: float,
    p_value: float,
    step_probability: float,
    step_dates: Sequence[str],
    **numbers: float,
) -> str:
    """Message of ``history.changed``.

    ``step_dates`` are the first and the last date between which a step is, with 95 % probability.
    ``numbers`` are the ends of the interval, the size of the step and the rate of false alarms.
    """
    verb = "slows" if percent > 0 else "becomes faster"
    text = (
        f"{subject} ({group}): the sensor {verb}: {percent:+.2g} % +- {u_percent:.2g} % over "
        f"{days:.0f} days (95 %: {numbers['low_percent']:+.2g} to {numbers['high_percent']:+.2g} "
        f"%; p = {p_value:.2g}). Of steady sensors, {numbers['rate_percent']:.2g} % get this "
        "warning"
    )
    if step_probability > 0.5:
        text += (
            f". A step of {numbers['step_percent']:+.2g} % between {step_dates[0]} and "
            f"{step_dates[1]} is more probable than a steady change"
        )
    return text + ". A change of flow, medium or mounting changes the lag, too"


def _history_groups(subject: str, names: Sequence[str], **_: Any) -> str:
    """Message of ``history.groups``.

    ``names`` are the conditions.
    """
    return (
        f"{subject}: measurements are compared only with those of the same method, medium and law, "
        f"since the lag depends on them: {', '.join(names)}"
    )


# tcdyn/sensors and tables compensated with a sensor file
SENSOR: dict[str, Message] = {
    "touch.count": "{count} touches found, {stated} stated: the order is not compared. Touch "
    "longer or wait longer between touches, and look at columns that did not respond",
    "touch.other": _touch_other,
    "touch.unclear": "touch {touch} ({time_s:.1f} s): {column} responded most, but {second} "
    "rose by {percent:.0f} % of it: touch this place again, nearer to one sensor",
    "touch.fall": "touch {touch} ({time_s:.1f} s): {column} falls by {fall_K:.2g} K before it "
    "rises by {rise_K:.2g} K: its polarity is reversed, or it was touched with something cold, and "
    "the time is that of the return",
    "touch.silent": _touch_silent,
    "history.changed": _history_changed,
    "history.groups": _history_groups,
    "history.failed": "{subject} is left out: {problem}",
    "ratio.conditions": "{subject} was measured by {condition}, {other} by {other_condition}: a "
    "lag depends on method, medium and flow, so the ratio is not that of the sensors alone",
    "ratio.one_dip": "{subject}: one dip does not tell how much dips differ, and the uncertainty "
    "does not include it: give a file of several dips",
    "ratio.stated": "{subject}: its lag is stated, not measured",
    "sensor.other_stream": "{subject}: the lag in the other stream, {lag_s:.3g} +- {u:.2g} s, is "
    "hardly known: it is the difference of two larger ones. Measure where the film is thin, as in "
    "water",
    "sensor.in_other": "{subject}: the chain in the file holds in the stream of the dip. In "
    "{medium} at {speed_m_s:g} m/s the lag is {lag_s:.4g} +- {u:.2g} s: make a file for it with "
    "`tcdyn sensor new --tau-s {lag_s:.4g}+-{u:.2g} --column {subject}`",
    "predict.still": "the {medium} is taken as still (natural convection): if it moves, state its "
    "speed (--speed-m-s), of which the lag is a strong function",
    "predict.size": "the diameter is {diameter_mm:g} mm, and the constructions that are averaged "
    "over are those of sheaths of {smallest_mm:g} to {largest_mm:g} mm: check the unit, and "
    "measure the sensor with a dip",
    "predict.no_liquid": "water at {T_degC:g} °C is no liquid at atmospheric pressure: its "
    "properties are extrapolated",
    "predict.rough": "the standard uncertainty of a time is {percent:.0f} % of it: "
    "constructions that catalogues do not tell apart differ that much here. Measure the sensor "
    "with a dip",
    "predict.exposed": "the wires of the exposed junction lead heat from the sheath over "
    "{length_mm:.2g} mm: the lag holds for wires that are exposed by more than twice of that; "
    "shorter ones follow the sheath",
    "sensor.exact": "the lag of {lag_s:.4g} s was given without an uncertainty: it is taken as "
    "exact, and the intervals of temperatures compensated with it include noise only; give an "
    "uncertainty, such as 1.5+-0.1",
    "sensor.gain": "{subject}: the gain is {gain:.4g} +- {u:.2g}, not 1: compensation removes the "
    "lag, but not the gain",
    "sensor.carried": _carried_columns,
    "sensor.unit_assumed": _unit_assumed,
    "sensor.undetermined": "column {subject}: the standard uncertainty of the lag, {u_s:.2g} s, "
    "exceeds the length of the record, {duration_s:.3g} s: the record does not determine the lag",
    "sensor.unit_doubt": "the median of column {subject} is {value:.4g} {unit}; is that its unit?",
    "sensor.short": "a segment of {count} rows is too short to be compensated: its results are "
    "empty",
    "sensor.dead": "column {subject} has too few readings in a segment: its results there are "
    "empty",
    "sensor.left": "column {subject} cannot be compensated in a segment ({problem}): its results "
    "there are empty",
    "sensor.coloured": "{subject}: the residuals of the fit are not white; the uncertainty "
    "includes their correlation",
    "sensor.misfit": "{subject}: the residuals of the fit are {rms_K:.2g} {unit} rms, but the "
    "noise is {noise_K:.2g} {unit}: the temperature around the sensor did not change in one clean "
    "step; or readings contain hum, or are clipped, repeated or drop-outs; or the junction is "
    "welded to the sheath, which must be stated; or the sensor is not a chain of lags. Plot the "
    "record",
    "sensor.entry_conflict": "{subject}: the entry was specified as {specified_s:.5g} +- "
    "{specified_u_s:.2g} s, but the response fits an entry at {fitted_s:.5g} s ({ratio:.2g} "
    "standard uncertainties): the specified instant is wrong, or there is a dead time, which the "
    "model does not have; the lag holds for the fitted entry",
    "sensor.dead_time": "{subject}: the response begins {dead_s:.3g} s after the specified entry, "
    "at {specified_s:.5g} s. It is taken as a dead time, which the times from the entry include. "
    "If the specified instant is wrong, the lag and these times are too long by {dead_s:.3g} s",
    "sensor.crossing": "{subject}: the reading passes {percent:.3g} % of the step {later_s:+.2g} s "
    "from the time of the fitted curve, {time_s:.4g} s, which the interval includes: the response "
    "is not that of a chain of lags, as where the lag changes with the temperature (radiation, "
    "natural convection, boiling); the lag holds for this step only",
    "sensor.radiation": "{subject}: in a gas, radiation changes by a factor of {ratio:.2g} within "
    "this step ({first_degC:.4g} to {last_degC:.4g} °C), and the lag with it: the lag is a mean "
    "over the step, and may be wrong by several tens of per cent for small changes. Step by less "
    "than 100 K at the temperature of use; in a liquid this does not matter",
    "sensor.slow_path": "{subject}: {percent:.2g} % of the step arrives with a time constant of "
    "{slow_s:.3g} s, through a second heat path such as stem, sheath or fitting: lag and t90 "
    "include it",
    "sensor.settles": "{subject}: the film coefficient was {ratio:.2g} times its later value "
    "right after the entry, and settled within about {settling_s:.2g} s, as where a hand moves the "
    "sensor and then holds it: the lag is that of the settled flow, t50, t63.2 and t90 are those "
    "of this dip. A stem that conducts gives a similar curve: if the junction is exposed, state it",
    "sensor.dip_means": "each row is a mean over the {averages_s:g} s before it, as specified: the "
    "lag is that of the sensor without this mean",
    "sensor.bath": "{subject}: the bath changes by {percent:+.2g} % of the step with a time "
    "constant of {bath_s:.2g} s after the entry, or the sensor warms it: lag and times are those "
    "of a step of the bath; stir, or use a larger bath",
    "sensor.fin": "{subject}: wires and stem conduct heat along themselves: by the model the "
    "reading settles at {percent:.3g} % of the step of the bath. Lag and times are those of the "
    "sensor's own final reading, in this depth of immersion; immerse it deeper",
    "sensor.causes": _undecided_causes,
    "sensor.no_rows_before": "{subject}: the response begins at the first row or before it: the "
    "level before the step is not known, and the lag may be too short; begin the record earlier, "
    "or specify the instant of entry with --entry-s",
    "sensor.structure_bound": "{subject}: the share of a second heat path is at its bound, "
    "{percent:.3g} %: the structure does not describe the response; check the filter after the "
    "sensor, and that the record holds one step",
    "sensor.medium": "{subject}: the lag of {lag_s:.2g} s is not long compared with that of the "
    "medium's own step, {medium_s:.2g} +- {medium_u_s:.2g} s: much of it may be the medium's; "
    "measure how fast the medium steps and specify it with --medium-s",
    "sensor.spikes": "{subject}: {count} reading(s) differ from their neighbours by far more "
    "than the noise: taken as missing",
    "sensor.earlier_event": "{subject}: the reading changes by {change_K:.3g} {unit} and goes "
    "back before the step, as after a splash: rows before {time_s:.6g} s are not used. If the "
    "sensor had not settled again at the step, repeat it",
    "sensor.next_event": "{subject}: the reading changes again at {time_s:.6g} s: rows from "
    "there on are not used",
    "sensor.cut_off": "{subject}: the record ends {after_s:.3g} s after the step, which is short "
    "for a lag of {lag_s:.3g} s: the final temperature is extrapolated",
    "sensor.directions": "{subject}: the lag is {heating_s:.3g} s when heated and "
    "{cooling_s:.3g} s when cooled: the difference is significant. The file is for both; for one "
    "direction give only dips of that direction",
    "sensor.dip_departs": _dip_departs,
    "sensor.dips_law": "{subject}: the lags do not follow {quantity} as a film of exponent "
    "{exponent:.2g} +- {exponent_u:.2g} does (p = {p_value:.1g}): check the flows and their order, "
    "or state another exponent",
    "sensor.dip_no_law": "{subject}: the response has a slow path, and a lag that follows a flow "
    "cannot have one: the file has no law, and its lag holds at {quantity} = {value:.4g}",
    "sensor.dip_film": "{subject}: the response does not allow a film with more than the largest "
    "time constant: the inner share of the lag is taken as {share:.2g}, not {stated:.2g}",
    "sensor.pair_difference": "{subject}: the traces determine the difference of the lags, "
    "{difference_s:.3g} +- {u_s:.2g} s, but hardly the lags themselves: the fluid changed too "
    "slowly for their ratio",
    "sensor.pair_construction": "{subject}: its lag is known to {percent:.2g} % only (95 %), "
    "because the construction of the sensors is unknown and may add short lags: a faster fluid "
    "does not help. Bare wires have none (option bare); otherwise use a plunge",
    "sensor.pair_gain": "{subject}: a change of temperature reads {percent:+.2g} +- {u:.1g} % "
    "larger than that of {other}: the lags are those of two sensors of different gain",
    "sensor.pair_clock": "{subject}: its delay behind {other} changes by {change_s:+.3g} s over "
    "the record ({rate_ppm:+.4g} +- {u_ppm:.2g} ppm), as where two loggers have clocks of "
    "different rate: the lags are wrong by more than their uncertainty. If the columns come from "
    "two clocks, multiply the time of the logger of {other} by {factor:.7g} and join the tables "
    "anew; otherwise the lags may change along the record: give the column of the flow",
    "sensor.pair_misfit": "{subject}: the two sensors do not measure one fluid through one lag "
    "or two each: the residuals are {ratio:.2g} times the noise; if the flow changes, give its "
    "column, and the lags follow it",
    "sensor.flow_held": "{subject}: the flow is missing in {percent:.2g} % of the rows, up to "
    "{longest_s:.4g} s: the value before is taken there; a negative flow counts as missing",
    "sensor.no_flow": "{subject}: the flow is missing in all rows of a part of the log; there the "
    "lag is that at {at:g}",
    "sensor.pair_flow": "{subject}: the lags change with the flow; the file contains those of "
    "{what}",
    "sensor.pair_exponent": "{subject}: the readings give an exponent of {exponent:.2g}, the "
    "stated one is {stated:.2g} +- {stated_u:.2g}: check the column of the speed, and the inner "
    "share",
    "sensor.conversion_wide": "{subject}: the response to the current does not determine the "
    "plunge's lag well: {low_s:.3g} to {high_s:.3g} s (95 %), because different films, walls and "
    "heated wires give the same response; a plunge would determine it",
    "sensor.conversion": "{subject}: the plunge's lag is converted from heating inside, to "
    "{percent:.2g} % (95 %): it holds for a round sensor that is heated about its axis and read "
    "there, with or without a gap below its sheath",
    "sensor.noise_driving": _noise_driving,
    "sensor.noise_unsteady": "{subject}: the fluctuations are {ratio:.2g} times as large in one "
    "quarter of the record as in another: the process is not steady",
    "sensor.noise_misfit": "{subject}: the spectrum is not that of white fluctuations through one "
    "or two lags (p = {p_value:.1g}): do not use the lag",
    "sensor.nothing": "nothing could be compensated in {subject}: the results are empty",
    "sensor.brief": "column {subject}: the table lasts {duration_s:.3g} s, less than the lag of "
    "{lag_s:.3g} s: is its time in another unit?",
    "sensor.unit_contradicted": "column {subject} is taken in {unit}, as requested, although its "
    "name states another unit",
    "sensor.unit_unknown": "column {subject}: its unit {unit} is not known here; it is taken as "
    "that of another quantity than temperature, which passes unchanged",
    "sensor.means": "each row is a mean over the {averages_s:g} s before it, which is removed with "
    "the lag. The lag must be that of the sensor alone: one that was measured with such rows "
    "contains half of this time, and then the mean must not be stated",
    "sensor.slow": "column {subject}: the interval of {dt_s:.3g} s between rows is long for a lag "
    "of {lag_s:.3g} s",
}

# The same about another quantity than temperature, where a message above speaks of heat.
OTHER_SENSOR: dict[str, Message] = {
    "sensor.codes": "column {subject}: {count} reading(s) such as {value:.4g} {unit} are drop-outs "
    "or overload codes; taken as missing: check the wiring",
    "sensor.misfit": "{subject}: the residuals of the fit are {rms_K:.2g} {unit} rms, but the "
    "noise is {noise_K:.2g} {unit}: the quantity around the sensor did not change in one clean "
    "step; or readings contain hum, or are clipped, repeated or drop-outs; or the sensor is not a "
    "chain of lags. Plot the record",
    "sensor.crossing": "{subject}: the reading passes {percent:.3g} % of the step {later_s:+.2g} s "
    "from the time of the fitted curve, {time_s:.4g} s, which the interval includes: the response "
    "is not that of a chain of lags; the lag holds for this step only",
    "sensor.slow_path": "{subject}: {percent:.2g} % of the step arrives with a time constant of "
    "{slow_s:.3g} s, through a second, slower path: lag and t90 include it",
    "sensor.structure_bound": "{subject}: the share of a second, slower path is at its bound, "
    "{percent:.3g} %: the structure does not describe the response; check the filter after the "
    "sensor, and that the record holds one step",
    "sensor.cut_off": "{subject}: the record ends {after_s:.3g} s after the step, which is short "
    "for a lag of {lag_s:.3g} s: the final reading is extrapolated",
    "sensor.directions": "{subject}: the lag is {heating_s:.3g} s when the reading rises and "
    "{cooling_s:.3g} s when it falls: the difference is significant. The file is for both; for one "
    "direction give only dips of that direction",
    "sensor.pair_gain": "{subject}: a change reads {percent:+.2g} +- {u:.1g} % larger than that of "
    "{other}: the lags are those of two sensors of different gain",
}
