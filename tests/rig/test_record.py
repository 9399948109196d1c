"""The record: whole, checked key by key, comparable with the one before."""

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
from tcdyn.report.page import write_page
from tcdyn.report.signed import signed_sections
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


def make_record(frame=None, **more) -> DiskRecord:
    fit = fit_static_lines(oven_frame() if frame is None else frame)
    fields = {
        "disk": "fast",
        "created": now_utc(),
        "static": fit.lines,
        "chain": make_chain(),
        **more,
    }
    return DiskRecord(**fields)


RECORD = make_record()


def test_a_record_reads_back_equal_with_the_contracts_keys(tmp_path):
    path = write_record(RECORD, tmp_path / "fast.disk.json")
    assert read_record(path) == RECORD
    keys = json.loads(path.read_text())
    assert keys["schema"] == "tcdyn.disk/2"
    wanted = {
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
    assert wanted <= set(keys)
    assert {"structure", "channels", "covariance", "common_lag_s", "differential_lag_s"} == set(
        keys["chain"]
    )
    assert {"value", "u", "low95", "high95"} == set(keys["chain"]["channels"]["a"]["lag_s"])


def test_the_filters_factors_make_its_polynomial_and_its_lag_is_their_first_moment():
    for shape in ("cascade", "butterworth"):
        for poles in range(1, 5):
            b = Conditioning(4.0, poles, shape)
            _, den = signal.butter(poles, 2 * np.pi * b.cutoff_Hz, analog=True)
            den = (
                den if shape == "butterworth" else np.poly(np.full(poles, -2 * np.pi * b.cutoff_Hz))
            )
            product = reduce(np.polymul, (f[::-1] for f in b.factors), [1.0])
            assert product == pytest.approx(
                den / den[-1], rel=1e-12
            )  # rounding of the polynomial's products
            assert b.lag_s == pytest.approx(den[-2] / den[-1], rel=1e-12)


NONSENSE = {
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


@pytest.mark.parametrize("key", NONSENSE)
def test_a_record_edited_to_nonsense_is_refused_by_key(key):
    value, words = NONSENSE[key]
    data = copy.deepcopy(json.loads(RECORD.to_json()))
    # a lag known to 0.2 s may be edited by 0.6 s unnoticed: make it well known first, so that the contradiction shows
    *path, last = key.split(".")
    place = data
    for part in path:
        place = place[part]
    place[last] = value
    if key == "conditioning.cutoff_Hz":
        for channel in data["chain"]["channels"].values():
            channel["lag_s"]["u"] = 0.005
        data["chain"]["covariance"] = (2.5e-5 * np.eye(6)).tolist()
    with pytest.raises(InputError, match=words):
        parse_record(data, "fast.disk.json")


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "not readable as JSON"),
        ("[1, 2]", "no disk record"),
        ("{}", "schema: the key is missing"),
        ('{"schema": "tcdyn.disk/2"}', "disk: Field required"),
        ('{"schema": "tcdyn.disk/2", "disk": "a", "disk": "b"}', "'disk' occurs twice"),
        (RECORD.to_json().replace('"offset": ', '"offset": NaN, "x": ', 1), "static"),
        (RECORD.to_json()[:500], "not readable as JSON"),
        ("[" * 100_000, "not readable as JSON|no disk record"),
    ],
)
def test_files_that_are_no_record_are_refused(tmp_path, text, words):
    with pytest.raises(InputError, match=words):
        read_record(write(tmp_path, "r.json", text))


def test_a_record_of_version_0_1_is_read_with_its_two_lags_and_written_as_today(tmp_path):
    old = Path(__file__).with_name(
        "of_version_0_1.disk.json"
    )  # of a simulated campaign; its fit is shortened
    before = json.loads(old.read_text())
    record = read_record(old)
    for c in CHANNELS:
        row = before["chain"]["channels"][c]
        now = record.chain.channels[c]
        assert now.taus_s == (row["tau1_s"], row["tau2_s"])
        assert now.lag_s.model_dump() == row["lag_s"]
        assert record.static[c].gain == before["static"][c]["gain"]
    assert record.warnings == before["warnings"]
    again = read_record(write_record(record, tmp_path / "new.json"))
    assert again == record
    del before["chain"]["channels"]["b"]["tau1_s"]
    with pytest.raises(InputError, match=r"chain\.channels\.b\.taus_s"):
        read_record(write(tmp_path, "old.json", json.dumps(before)))


CHAINS = {
    "three lags": Chain((0.4, 0.2, 0.1), conditioning=RIG_FILTER),
    "a lag, a zero and a dead time": Chain(
        (0.5,), zero_s=0.1, delay_s=0.2, conditioning=RIG_FILTER
    ),
    "a pair": Chain((), pair=(0.3, 0.5), conditioning=RIG_FILTER),
    "a cement": Chain((0.2,), cement_s=0.8, conditioning=RIG_FILTER),
}


@pytest.mark.parametrize("name", CHAINS)
def test_a_record_keeps_any_chain_as_it_is(name, tmp_path):
    chain = CHAINS[name]
    lag = Estimate.normal(chain.lag_s, 0.2)
    rows = {c: ChannelChain(**chain.parameters, lag_s=lag) for c in CHANNELS}
    apart = {c: Estimate.normal(0.0, 0.005) for c in CHANNELS}
    covariance = (0.04 * np.ones((6, 6)) + 2.5e-5 * np.eye(6)).tolist()
    common = ChainRecord(
        structure="any",
        channels=rows,
        covariance=covariance,
        common_lag_s=lag,
        differential_lag_s=apart,
    )
    record = read_record(write_record(make_record(chain=common), tmp_path / "r.json"))
    assert {*record_chains(record, record.disk_setup())} == {chain}


def test_records_of_two_disks_are_not_compared():
    with pytest.raises(InputError, match="one disk"):
        compare_records(RECORD, make_record(disk="slow"))


def again(seed: int, drift_K: float = 0.0):
    """A second oven of the disk of seed 0, channel b reading ``drift_K`` lower."""
    gain, offset = oven_truth(0)
    frame = oven_frame(seed)
    own_gain, own_offset = oven_truth(seed)
    for k, c in enumerate(CHANNELS):
        true = own_gain[k] * frame[f"{c}_degC"] + own_offset[k]
        frame[f"{c}_degC"] = (true - offset[k] - (drift_K if c == "b" else 0.0)) / gain[k]
    return frame


@pytest.mark.e2e
def test_drift_between_two_calibrations_is_significant_when_real_and_rarely_otherwise():
    false = [
        len(compare_records(RECORD, make_record(again(s))).significant) > 0 for s in range(1, 61)
    ]
    assert np.mean(false) <= 0.14  # 5 % over all rows, three sigma of 60 above it
    found = compare_records(RECORD, make_record(again(1, 0.5)))
    assert {q[0] for q in found.significant["quantity"]} == {"b"}
    assert "drifted significantly: b" in found.sentence()


def test_a_changed_differential_lag_is_significant_though_the_common_one_is_loose():
    found = compare_records(RECORD, make_record(chain=make_chain(0.06)))
    assert "e differential lag_s" in set(found.significant["quantity"])
    assert "e lag_s" not in set(found.significant["quantity"])


LEVELS = "P1.csv: column switch: levels 0 and 5 are read as 0 and 1"
MENDED = info("said", text=LEVELS)


def test_a_record_that_has_sentences_only_keeps_them_as_they_stand():
    old = RECORD.to_dict()
    del old["findings"], old["sha256"]
    back = parse_record({**old, "warnings": ["the clock stood still", LEVELS]}, "a")
    assert back.warnings == ["the clock stood still", LEVELS]
    assert [f.code for f in back.findings] == ["said", "said"]
    assert parse_record(back.to_dict(), "a") == back


def test_check_names_what_a_reader_would_ask():
    assert check_record(RECORD) == ()
    odd = make_record(
        chain=None,
        created="2999-01-01T00:00:00+00:00",
        findings=[warning("said", text="hand made"), MENDED],
    )
    assert [f.code for f in check_record(odd)] == ["said", "record.future", "record.no_chain"]
    assert (
        check_record(make_record(findings=[MENDED])) == ()
    )  # a info: mended in full, nothing to decide


def test_what_the_tests_of_a_line_say_is_found_in_a_record_of_version_0_1_too():
    data = json.loads(Path(__file__).with_name("of_version_0_1.disk.json").read_text())
    data["static"]["c"]["quadratic_p"] = 1e-4
    (curved,) = (f for f in check_record(parse_record(data, "old")) if f.code.startswith("line."))
    assert (curved.code, curved.subject, curved.numbers) == ("line.curved", "c", {"p": 1e-4})


def test_only_keys_of_the_rig_that_changed_are_named_and_columns_are_none():
    data = RECORD.to_dict()
    data["setup"]["columns"] = {"fast_a_degC": "TC1"}
    assert compare_records(RECORD, parse_record(data, "b")).notes == ()
    data["setup"]["disk"]["conductivity_W_mK"] = 43.0
    (info,) = compare_records(RECORD, parse_record(data, "b")).notes
    assert info == "[disk] conductivity_W_mK was 41.0, is 43.0"


def test_the_commands_show_compare_and_check(tmp_path):
    runner = CliRunner()
    one = write_record(RECORD, tmp_path / "a.json")
    two = write_record(make_record(again(1, 0.5)), tmp_path / "b.json")
    shown = runner.invoke(app, ["show", str(one)])
    assert shown.exit_code == 0
    assert "common" in shown.output
    compared = runner.invoke(app, ["diff", str(one), str(two)])
    assert compared.exit_code == 0
    assert "drifted significantly" in compared.output
    assert runner.invoke(app, ["diff", "--all", str(one), str(one)]).output.count("lag_s") >= 6
    assert runner.invoke(app, ["check", str(one)]).exit_code == 0
    write(tmp_path, "c.json", RECORD.to_json().replace('"disk": "fast"', '"disk": 7'))
    refused = runner.invoke(app, ["check", str(tmp_path / "c.json")])
    assert isinstance(refused.exception, InputError)


def test_lags_are_drawn_with_their_intervals_and_differences_with_theirs_about_the_common_lag():
    chain = make_chain()
    ax = draw_lags(chain, figure()[1][0])
    bars = [
        line.get_ydata()
        for line in ax.lines
        if len(line.get_ydata()) == 2 and np.ptp(line.get_xdata()) == 0
    ]
    for c, thin, thick in zip(sorted(chain.channels), bars[::2], bars[1::2], strict=True):
        lag = chain.channels[c].lag_s
        apart = chain.differential_lag_s[c]
        assert thin == pytest.approx([lag.low95, lag.high95])
        assert thick == pytest.approx(
            [chain.common_lag_s.value + end for end in (apart.low95, apart.high95)]
        )


def test_the_certificate_is_one_page_with_a_verdict_on_each_thermocouple(tmp_path):
    oven = fit_static_lines(oven_frame())
    page = write_page(
        tmp_path / "fast.html",
        "Disk fast",
        [*signed_sections(RECORD), *certificate_sections(RECORD, oven)],
        verdict=certificate_verdict(RECORD),
        assumptions=certificate_assumptions(RECORD),
    )
    text = page.read_text()
    assert "6 of 6 thermocouples fit to use" in text
    assert text.count("data:image/png") == 3  # errors, residuals, lags
    assert "Made from" in text
