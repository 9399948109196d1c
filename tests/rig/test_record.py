"""The calibration record: complete, checked key by key, and comparable with the previous one."""

from __future__ import annotations

import copy
import json
from functools import reduce
from pathlib import Path

import numpy as np
import pytest
from scipy import signal
from typer.testing import CliRunner

from calibration.compare import check_record, compare_records
from calibration.static_lines import fit_static_lines
from tcdyn.chain import Chain
from tcdyn.cli.record import app
from tcdyn.core.errors import InputError
from tcdyn.core.estimate import Estimate
from tcdyn.core.findings import info, warning
from tcdyn.plots.calibration import draw_lags
from tcdyn.plots.style import figure
from tcdyn.report.certificate import (
    certificate_assumptions,
    certificate_sections,
    certificate_verdict,
)
from tcdyn.report.formal import formal_sections
from tcdyn.report.page import write_page
from tcdyn.rig.disk import CHANNELS, Conditioning
from tcdyn.rig.record import (
    ChainRecord,
    ChannelChain,
    DiskRecord,
    now_utc,
    parse_record,
    read_record,
    write_record,
)
from tcdyn.rig.rigfile import load_rig
from tcdyn.smoothing.traces import record_chains
from tests.rig.log_cases import oven_frame, oven_truth, write

RIG_FILTER = Conditioning(cutoff_Hz=4.0, poles=2)


def make_chain(shift_s: float = 0.0) -> ChainRecord:
    """A chain record; channel e is shifted by ``shift_s``."""
    lags = {c: 0.70 + 0.01 * k + (shift_s if c == "e" else 0.0) for k, c in enumerate(CHANNELS)}
    common = float(np.mean(list(lags.values())))
    filter_s = load_rig().common.conditioning.lag_s
    covariance = 0.04 * np.ones((6, 6)) + 2.5e-5 * np.eye(6)
    u = float(np.sqrt(covariance[0, 0]))
    return ChainRecord(
        structure="P2",
        channels={
            c: ChannelChain(taus_s=(lag - filter_s - 0.1, 0.1), lag_s=Estimate.normal(lag, u))
            for c, lag in lags.items()
        },
        covariance=covariance.tolist(),
        common_lag_s=Estimate.normal(common, 0.2),
        differential_lag_s={c: Estimate.normal(lag - common, 0.005) for c, lag in lags.items()},
    )


def make_record(frame=None, **overrides) -> DiskRecord:
    """A record of the oven frame; keywords override its fields."""
    fit = fit_static_lines(oven_frame() if frame is None else frame)
    fields = {
        "disk": "fast",
        "created": now_utc(),
        "static": fit.lines,
        "chain": make_chain(),
        **overrides,
    }
    return DiskRecord(**fields)


RECORD = make_record()


def test_record_reads_back_equal_with_the_documented_keys(tmp_path):
    path = write_record(RECORD, tmp_path / "fast.disk.json")
    assert read_record(path) == RECORD
    keys = json.loads(path.read_text())
    assert keys["schema"] == "tcdyn.disk/2"
    expected_keys = {
        "schema",
        "disk",
        "created",
        "inputs",
        "static",
        "chain",
        "conditioning",
        "fit",
        "warnings",
        "setup",
    }
    assert expected_keys <= set(keys)
    assert {"structure", "channels", "covariance", "common_lag_s", "differential_lag_s"} == set(
        keys["chain"]
    )
    assert {"value", "u", "low95", "high95"} == set(keys["chain"]["channels"]["a"]["lag_s"])


def test_filter_factors_multiply_to_its_polynomial_and_its_lag_is_their_first_moment():
    for shape in ("cascade", "butterworth"):
        for poles in range(1, 5):
            b = Conditioning(4.0, poles, shape)
            corner = 2 * np.pi * b.cutoff_Hz
            _, butterworth = signal.butter(poles, corner, analog=True)
            cascade = np.poly(np.full(poles, -corner))
            den = butterworth if shape == "butterworth" else cascade
            product = reduce(np.polymul, (f[::-1] for f in b.factors), [1.0])
            # rounding of the products of the polynomial
            assert product == pytest.approx(den / den[-1], rel=1e-12)
            assert b.lag_s == pytest.approx(den[-2] / den[-1], rel=1e-12)


INVALID_VALUES = {
    "schema": ("tcdyn.disk/9", "schema"),
    "disk": ("", "disk"),
    "created": ("yesterday", "created"),
    "inputs": ([{"file": "x", "sha256": "123"}], r"inputs\.0\.sha256"),
    "static.a.gain": (101.0, r"static\.a\.gain"),
    "static.b.offset": ("warm", r"static\.b\.offset"),
    "static.c.covariance": ([[1.0, 5.0], [5.0, 1.0]], r"static\.c"),
    "static.c.range_degC": ([160.0, 20.0], r"static\.c"),
    "static.q": (
        {"gain": 1.0, "offset": 0.0, "covariance": [[0, 0], [0, 0]], "range_degC": [20, 160]},
        r"static\.q",
    ),
    "static.d.gian": (1.0, r"static\.d\.gian"),
    "chain.channels.a.taus_s": ([0.6, -0.5], r"chain\.channels\.a\.taus_s\.1"),
    "chain.channels.a.lag_s.value": (9.0, r"chain"),
    "chain.channels.a.lag_s.u": (None, r"chain\.channels\.a\.lag_s\.u"),
    "chain.covariance": ([[1.0]], r"chain.*covariance"),
    "chain.common_lag_s.value": (5.0, r"chain.*common_lag_s"),
    "chain.differential_lag_s.f.value": (0.9, r"chain.*differential_lag_s\.f"),
    "conditioning.shape": ("bessel", r"conditioning\.shape"),
    "conditioning.cutoff_Hz": (40.0, r"chain\.channels"),
    "setup.disk.width_mm": (0.00953, r"setup\.disk\.width_mm"),
    "warnings": ("none", "warnings"),
    "colour": ("red", "colour"),
}


@pytest.mark.parametrize("key", INVALID_VALUES)
def test_record_with_an_invalid_value_raises_and_names_the_key(key):
    value, message = INVALID_VALUES[key]
    data = copy.deepcopy(json.loads(RECORD.to_json()))
    # a change by 0.6 s of a lag known to 0.2 s would pass: a small uncertainty makes the
    # contradiction visible
    *path, last = key.split(".")
    entry = data
    for key_part in path:
        entry = entry[key_part]
    entry[last] = value
    if key == "conditioning.cutoff_Hz":
        for channel in data["chain"]["channels"].values():
            channel["lag_s"]["u"] = 0.005
        data["chain"]["covariance"] = (2.5e-5 * np.eye(6)).tolist()
    with pytest.raises(InputError, match=message):
        parse_record(data, "fast.disk.json")


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "not readable as JSON"),
        ("[1, 2]", "not a disk record"),
        ("{}", "no key schema"),
        ('{"schema": "tcdyn.disk/2"}', "disk: Field required"),
        ('{"schema": "tcdyn.disk/2", "disk": "a", "disk": "b"}', "'disk' occurs twice"),
        (RECORD.to_json().replace('"offset": ', '"offset": NaN, "x": ', 1), "static"),
        (RECORD.to_json()[:500], "not readable as JSON"),
        ("[" * 100_000, "not readable as JSON|not a disk record"),
    ],
)
def test_files_that_are_not_records_raise(tmp_path, text, message):
    with pytest.raises(InputError, match=message):
        read_record(write(tmp_path, "r.json", text))


def test_record_of_version_0_1_is_read_with_its_two_lags_and_written_in_the_current_format(
    tmp_path,
):
    # from a simulated campaign; its fit is shortened
    old_file = Path(__file__).with_name("of_version_0_1.disk.json")
    stored = json.loads(old_file.read_text())
    record = read_record(old_file)
    for c in CHANNELS:
        row = stored["chain"]["channels"][c]
        channel = record.chain.channels[c]
        assert channel.taus_s == (row["tau1_s"], row["tau2_s"])
        assert channel.lag_s.model_dump() == row["lag_s"]
        assert record.static[c].gain == stored["static"][c]["gain"]
    assert record.warnings == stored["warnings"]
    rewritten = read_record(write_record(record, tmp_path / "new.json"))
    assert rewritten == record
    del stored["chain"]["channels"]["b"]["tau1_s"]
    with pytest.raises(InputError, match=r"chain\.channels\.b\.taus_s"):
        read_record(write(tmp_path, "old.json", json.dumps(stored)))


CHAINS = {
    "three lags": Chain((0.4, 0.2, 0.1), conditioning=RIG_FILTER),
    "lag, zero and dead time": Chain((0.5,), zero_s=0.1, delay_s=0.2, conditioning=RIG_FILTER),
    "complex pair": Chain((), pair=(0.3, 0.5), conditioning=RIG_FILTER),
    "cement": Chain((0.2,), cement_s=0.8, conditioning=RIG_FILTER),
}


@pytest.mark.parametrize("name", CHAINS)
def test_record_preserves_any_chain(name, tmp_path):
    chain = CHAINS[name]
    lag = Estimate.normal(chain.lag_s, 0.2)
    rows = {c: ChannelChain(**chain.parameters, lag_s=lag) for c in CHANNELS}
    differential = {c: Estimate.normal(0.0, 0.005) for c in CHANNELS}
    covariance = (0.04 * np.ones((6, 6)) + 2.5e-5 * np.eye(6)).tolist()
    common = ChainRecord(
        structure="any",
        channels=rows,
        covariance=covariance,
        common_lag_s=lag,
        differential_lag_s=differential,
    )
    record = read_record(write_record(make_record(chain=common), tmp_path / "r.json"))
    assert {*record_chains(record, record.disk_setup())} == {chain}


def test_records_of_two_disks_cannot_be_compared():
    with pytest.raises(InputError, match="one disk"):
        compare_records(RECORD, make_record(disk="slow"))


def second_oven_frame(seed: int, drift_K: float = 0.0):
    """A second oven log of the disk of seed 0; channel b reads ``drift_K`` lower."""
    gain, offset = oven_truth(0)
    frame = oven_frame(seed)
    other_gain, other_offset = oven_truth(seed)
    for k, c in enumerate(CHANNELS):
        true_degC = other_gain[k] * frame[f"{c}_degC"] + other_offset[k]
        frame[f"{c}_degC"] = (true_degC - offset[k] - (drift_K if c == "b" else 0.0)) / gain[k]
    return frame


@pytest.mark.e2e
def test_drift_between_two_calibrations_is_significant_if_real_and_rarely_otherwise():
    false_alarms = [
        len(compare_records(RECORD, make_record(second_oven_frame(s))).significant) > 0
        for s in range(1, 61)
    ]
    assert np.mean(false_alarms) <= 0.14  # 5 % over all rows, three sigma of 60 above it
    comparison = compare_records(RECORD, make_record(second_oven_frame(1, 0.5)))
    assert {q[0] for q in comparison.significant["quantity"]} == {"b"}
    assert "drifted significantly: b" in comparison.sentence()


def test_changed_differential_lag_is_significant_despite_an_uncertain_common_lag():
    comparison = compare_records(RECORD, make_record(chain=make_chain(0.06)))
    assert "e differential lag_s" in set(comparison.significant["quantity"])
    assert "e lag_s" not in set(comparison.significant["quantity"])


LEVELS = "P1.csv: column switch: levels 0 and 5 are read as 0 and 1"
LEVELS_INFO = info("from_file", text=LEVELS)


def test_record_with_sentences_only_preserves_them():
    record_keys = RECORD.to_dict()
    del record_keys["findings"], record_keys["sha256"]
    parsed = parse_record({**record_keys, "warnings": ["the clock stood still", LEVELS]}, "a")
    assert parsed.warnings == ["the clock stood still", LEVELS]
    assert [f.code for f in parsed.findings] == ["from_file", "from_file"]
    assert parse_record(parsed.to_dict(), "a") == parsed


def test_check_names_missing_chain_and_future_date():
    assert check_record(RECORD) == ()
    questionable = make_record(
        chain=None,
        created="2999-01-01T00:00:00+00:00",
        findings=[warning("from_file", text="hand made"), LEVELS_INFO],
    )
    assert [f.code for f in check_record(questionable)] == [
        "from_file",
        "record.future",
        "record.no_chain",
    ]
    # an info: corrected, nothing to decide
    assert check_record(make_record(findings=[LEVELS_INFO])) == ()


def test_line_tests_are_reported_for_a_record_of_version_0_1():
    data = json.loads(Path(__file__).with_name("of_version_0_1.disk.json").read_text())
    data["static"]["c"]["quadratic_p"] = 1e-4
    (curved,) = (f for f in check_record(parse_record(data, "old")) if f.code.startswith("line."))
    assert (curved.code, curved.subject, curved.numbers) == ("line.curved", "c", {"p": 1e-4})


def test_comparison_names_only_changed_rig_keys_and_ignores_columns():
    data = RECORD.to_dict()
    data["setup"]["columns"] = {"fast_a_degC": "TC1"}
    assert compare_records(RECORD, parse_record(data, "b")).notes == ()
    data["setup"]["disk"]["conductivity_W_mK"] = 43.0
    (info,) = compare_records(RECORD, parse_record(data, "b")).notes
    assert info == "[disk] conductivity_W_mK was 41.0, is 43.0"


def test_record_commands_show_diff_and_check(tmp_path):
    runner = CliRunner()
    first = write_record(RECORD, tmp_path / "a.json")
    second = write_record(make_record(second_oven_frame(1, 0.5)), tmp_path / "b.json")
    show_result = runner.invoke(app, ["show", str(first)])
    assert show_result.exit_code == 0
    assert "common" in show_result.output
    diff_result = runner.invoke(app, ["diff", str(first), str(second)])
    assert diff_result.exit_code == 0
    assert "drifted significantly" in diff_result.output
    assert runner.invoke(app, ["diff", "--all", str(first), str(first)]).output.count("lag_s") >= 6
    assert runner.invoke(app, ["check", str(first)]).exit_code == 0
    write(tmp_path, "c.json", RECORD.to_json().replace('"disk": "fast"', '"disk": 7'))
    check_result = runner.invoke(app, ["check", str(tmp_path / "c.json")])
    assert isinstance(check_result.exception, InputError)


def test_lags_are_plotted_with_intervals_of_common_and_differential_lag():
    chain = make_chain()
    ax = draw_lags(chain, figure()[1][0])
    bars = [
        line.get_ydata()
        for line in ax.lines
        if len(line.get_ydata()) == 2 and np.ptp(line.get_xdata()) == 0
    ]
    for c, lag_bar, differential_bar in zip(
        sorted(chain.channels), bars[::2], bars[1::2], strict=True
    ):
        lag = chain.channels[c].lag_s
        differential = chain.differential_lag_s[c]
        assert lag_bar == pytest.approx([lag.low95, lag.high95])
        assert differential_bar == pytest.approx(
            [
                chain.common_lag_s.value + limit
                for limit in (differential.low95, differential.high95)
            ]
        )


@pytest.mark.e2e
def test_certificate_is_one_page_with_a_result_for_each_thermocouple(tmp_path):
    oven = fit_static_lines(oven_frame())
    page = write_page(
        tmp_path / "fast.html",
        "Disk fast",
        [*formal_sections(RECORD), *certificate_sections(RECORD, oven)],
        verdict=certificate_verdict(RECORD),
        assumptions=certificate_assumptions(RECORD),
    )
    text = page.read_text()
    assert "6 of 6 thermocouples fit to use" in text
    assert text.count("data:image/png") == 3  # errors, residuals, lags
    assert "Made from" in text
