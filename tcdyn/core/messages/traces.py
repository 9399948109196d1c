"""What is said of traces, compensated ones and pipelines."""

from __future__ import annotations

from tcdyn.core.messages.phrases import Message

# tcdyn/smoothing
COMPENSATE: dict[str, Message] = {
    "trace.stuck": "{subject}: stuck or saturated in {percent:.2g} % of the record, first at sample {first_sample}; "
    "those samples are treated as missing",
    "trace.outside": "{subject}: {count} reading(s) such as {value:.4g} degC at sample {first_sample} are outside the "
    "physical range of a thermocouple (-273 to 3000 degC); taken as missing",
    "trace.codes": "{subject}: {count} reading(s) of {value:.4g} degC, the first at sample {first_sample}, are "
    "drop-outs; taken as missing: check the wiring",
    "trace.unreachable": "{subject}: {count} reading(s), the first {value:.4g} degC at sample {first_sample}, change "
    "faster than any temperature could make this sensor change; taken as missing: check the wiring, or the lag of the "
    "sensor",
    "trace.undetermined": "{subject}: {percent:.3g} % of the record, first at sample {first_sample}, is not determined "
    "by it: the standard uncertainty exceeds the range of the readings ({range_K:.3g} K), or the temperature is not "
    "possible; not reported there",
    "trace.bad": "{subject}: {percent:.2g} % of the samples are missing or spikes and carry no weight",
    "inverse.noisy": lambda bandwidth_Hz, noise_K, limit_K, best_Hz, **_: (
        f"a bandwidth of {bandwidth_Hz:.3g} Hz makes {noise_K:.3g} K of noise, more than the {limit_K:.3g} K allowed: "
        + (f"at most {best_Hz:.3g} Hz can be had" if best_Hz > 0 else "no bandwidth gives that")
        + " at this noise"
    ),
    "inverse.near_nyquist": "a bandwidth of {bandwidth_Hz:.3g} Hz is near half of the {rate_Hz:.3g} Hz sampling: "
    "between samples the answer is not what the formula says",
    "inverse.dead_time": "dead time and right-half-plane zeros cannot be inverted: they remain as a shift",
    "live.noisy": "the answer has {gain:.3g} times the trace's noise: a lower intensity or some lag behind makes it "
    "quieter",
}

# tcdyn/traces
TRACES: dict[str, Message] = {
    "spikes.gathered": "{count} spikes in {columns} channels were taken as missing, most in {subject} ({of_most})",
    "traces.gaps": "{subject}: {percent:.1f} % of the samples are spikes or missing",
    "noise.hum": "{subject}: hum of {amplitude_K:.2g} K at {f_Hz:.2f} Hz",
    "noise.folded": "{subject}: the sampling may lay harmonics of mains hum upon the temperature itself, where nothing "
    "tells them: {folded_K:.2g} K were added to its u; a rate that divides no multiple of the mains frequency "
    "avoids it",
    "noise.unexplained": "{subject}: in a part of its spectrum the noise is {ratio:.1f} times what white noise before "
    "and behind the conditioning filter explains; its level was taken no lower than where temperatures move",
    "noise.coloured": lambda subject, before_K, after_K, lag_s=0.0, **_: (
        f"{subject}: noise of {before_K:.2g} K "
        + (
            f"is coloured as by a lag of {lag_s:.2g} s"
            if lag_s
            else "comes through the conditioning filter"
        )
        + f", of {after_K:.2g} K {'is white' if lag_s else 'from behind it'}; all that follows counts with both"
    ),
    "traces.coarse": lambda subject, step_K, channels, **_: (
        f"{subject} disk: the logger writes in steps of {step_K:.2g} K, coarser than the noise, in "
        f"{', '.join(channels)}: such rounding is no white noise, and lags and transient fits may be further off than "
        "they say"
    ),
}

# tcdyn/workflows
PIPELINE: dict[str, Message] = {
    "calibrate.other_disk": "{count} static lines do not fit the plunges: is the oven log of the disk that was plunged "
    "({subject}), and the wiring the same?",
    "bearing.extrapolated": "bearing friction at {load_N:.0f} N and {speed_rpm:.0f} rpm is extrapolated: {file} covers "
    "{loads_N[0]:.0f} to {loads_N[1]:.0f} N and {speeds_rpm[0]:.0f} to {speeds_rpm[1]:.0f} rpm",
    "verify.differs": "{source}: {subject}: {ours} for {published}",
    "compensate.one_disk": lambda subject, other, option, **_: (
        f"no record of the {subject} disk was given: its columns are as logged, and the lag common to the {other} disk "
        f"is the record's, which an unloading would tell better; add {option('records', f'{subject}.disk.json')}"
    ),
    "compensate.unrefined": "the common lags are the records': the unloading could not be used ({problem})",
    "follow.dead": "column {subject} shows nothing: it is left empty",
    "follow.spikes": "{count} samples stand in spikes or bursts",
    "follow.backward": "{count} rows whose time does not rise were left out",
    "follow.gaps": "{count} gaps in time_s, the longest of {longest_s:.3g} s: beside them the bands are wide",
    "follow.impossible": "{count} readings of {subject} lie outside {low_degC:g} to {high_degC:g} degC, the first at "
    "{first_s:.6g} s: treated as missing (open circuit or overload of the logger?)",
    "follow.unreachable": "{count} readings of {subject} changed faster than any temperature can through the lag of "
    "the sensor, the first at {first_s:.6g} s: treated as missing (unplugged sensor, invalid readings, or a wrong lag "
    "in the sensor file?)",
    "follow.restarted": "{subject} started anew at another level of the readings (times: {count}), because those at "
    "the level before were too few or too long ago",
    "follow.blank": "{count} answers of {subject} lie outside {low_degC:g} to {high_degC:g} degC: left empty",
    "follow.torn": "{count} lines without the right number of fields were left out",
}
