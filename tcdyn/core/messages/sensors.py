"""What is said of other thermocouples and tables."""

from __future__ import annotations

from tcdyn.core.messages.phrases import Message, count_with_noun

# tcdyn/sensors and tables compensated with it
SENSOR: dict[str, Message] = {
    "sensor.exact": "the lag of {lag_s:.4g} s was stated without an uncertainty: it is taken as exact, and the bands "
    "of what it compensates hold noise only; state one, such as 1.5+-0.1",
    "sensor.gain": "{subject}: the gain is {gain:.4g} +- {u:.2g}, not 1: the lag is removed, the gain is left in",
    "sensor.carried": lambda columns, **_: (
        f"{count_with_noun(len(columns), 'column')} no sensor covers, carried over as logged: {', '.join(columns)}"
    ),
    "sensor.unit_assumed": lambda subject, count=1, **_: (
        f"{'column' if count == 1 else 'columns'} {subject} {'states' if count == 1 else 'state'} no unit: read as "
        "degrees Celsius"
    ),
    "sensor.codes": "column {subject}: {count} reading(s) such as {value:.4g} degC are drop-outs or outside the "
    "physical range of a thermocouple; taken as missing: check the wiring",
    "sensor.undetermined": "column {subject}: the standard uncertainty of the lag, {u_s:.2g} s, exceeds the length of "
    "the record, {duration_s:.3g} s: the record does not determine the lag",
    "sensor.unit_doubt": "column {subject} reads {value:.4g} {unit} in the middle; is that its unit?",
    "sensor.few_decimals": lambda rate_Hz, percent=0.0, **_: (
        f"the clock has few decimals: rows are taken as even, {rate_Hz:.5g} Hz"
        + (f", known to {percent:.2g} % (1 sd): so are the lags" if percent > 1 else "")
    ),
    "sensor.repeated": "{count} time stamp(s) are repeated, first in row {row} below the header; rows of one time are "
    "averaged",
    "sensor.uneven": "rows stray from even sampling at {rate_Hz:.5g} Hz by {stray_s:.2g} s (1 sd): answers are that "
    "uncertain in time",
    "sensor.short": "a stretch of {count} rows is too short to be compensated: its answers are empty",
    "sensor.dead": "column {subject} shows nothing in a stretch: its answers there are empty",
    "sensor.left": "column {subject} cannot be compensated in a stretch ({problem}): its answers there are empty",
    "sensor.coloured": "{subject}: what the fit leaves is not white; its colour is taken into account",
    "sensor.misfit": "{subject}: the fit leaves {rms_K:.2g} K rms where the noise is {noise_K:.2g} K: the surroundings "
    "did not make one clean step, or the sensor is no chain of lags",
    "sensor.entry_conflict": "{subject}: the entry was specified as {specified_s:.5g} +- {specified_u_s:.2g} s, but "
    "the response fits an entry at {fitted_s:.5g} s ({ratio:.2g} standard uncertainties): the specified instant is "
    "wrong, or there is a dead time, which the model does not have; the lag holds for the fitted entry",
    "sensor.cut_off": "{subject}: the record ends {after_s:.3g} s after the step, for a lag of {lag_s:.3g} s: its "
    "end is extrapolated",
    "sensor.pair_difference": "{subject}: the traces tell the difference of the lags, {difference_s:.3g} +- {u_s:.2g} "
    "s, but hardly the lags themselves: the fluid changed too slowly for their ratio",
    "sensor.pair_slower": "{subject} has a new value in {percent:.3g} % of the rows (every {interval_s:.3g} s on "
    "average) and is repeated or blank in the others: only new values are used, as sampled at the time of their row",
    "sensor.pair_misfit": "{subject}: the two do not see one fluid through one lag each: what is left is {ratio:.2g} "
    "times the noise",
    "sensor.pair_flow": "{subject}: the lags change with the flow; the file holds those of {what}",
    "sensor.conversion_wide": "{subject}: the answer to the current does not tell the plunge's lag well: {low_s:.3g} "
    "to {high_s:.3g} s (95 %), for films, walls and heated wires that would answer alike; a plunge would tell",
    "sensor.conversion": "{subject}: the plunge's lag is converted from heating inside, to {percent:.2g} % (95 %): it "
    "holds for a round sensor that is heated about its axis and read there",
    "sensor.noise_driving": lambda subject, lags, **_: (
        f"{subject}: the lag is the sensor's if the fluid's own fluctuations are white; slower ones add their time"
        + ("; of the two lags found one may be the fluid's" if lags == 2 else "")
    ),
    "sensor.noise_unsteady": "{subject}: the fluctuations are {ratio:.2g} times as large in one quarter as in another: "
    "the process is not steady",
    "sensor.noise_misfit": "{subject}: the spectrum is not that of white fluctuations behind one or two lags (p = "
    "{p_value:.1g}): the lag is not to be trusted",
    "sensor.brief": "column {subject}: the table lasts {duration_s:.3g} s, less than the lag of {lag_s:.3g} s: is its "
    "time in another unit?",
    "sensor.unit_contradicted": "column {subject} is taken in {said}, as was asked for, though its name says otherwise",
    "sensor.slow": "column {subject}: rows every {dt_s:.3g} s are slow for a lag of {lag_s:.3g} s",
}
