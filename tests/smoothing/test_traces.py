"""Log and record to traces: what a record gives, a rig file that contradicts it, and each channel
looked at once."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

from tcdyn.core.errors import InputError
from tcdyn.rig.disk import Conditioning
from tcdyn.rig.record import DiskRecord
from tcdyn.rig.rigfile import load_rig
from tcdyn.simulate.truth import draw_truth
from tcdyn.smoothing import traces
from tcdyn.smoothing.traces import disk_traces, record_chains
from tcdyn.workflows import compensate, compensate_stages
from tests.conftest import Campaign
from tests.partition.study_rigs import _record


@pytest.fixture(scope="module")
def record() -> DiskRecord:
    return _record(1, "fast", draw_truth(1), load_rig(), 0.0)


def test_chains_of_a_record_have_the_lags_that_it_states(record: DiskRecord) -> None:
    assert record.chain is not None
    for chain, channel in zip(
        record_chains(record, load_rig().disk_setup("fast")), "abcdef", strict=True
    ):
        assert chain.lag_s == pytest.approx(
            record.chain.channels[channel].lag_s.value, abs=1e-9
        )  # rounding


def test_a_rig_file_with_another_filter_is_refused(record: DiskRecord) -> None:
    """A 10 Hz filter beside a record made with 4 Hz would take 48 ms off every lag, and nobody
    would notice."""
    setup = replace(load_rig().disk_setup("fast"), conditioning=Conditioning(10.0, 2))
    with pytest.raises(InputError, match="made with conditioning of 2 pole"):
        record_chains(record, setup)


def test_a_logger_whose_steps_hide_the_noise_is_named(record: DiskRecord) -> None:
    rng = np.random.default_rng(0)
    t = np.arange(3000) / 75
    fine = {f"fast_{c}_degC": 90 + 0.1 * t + 0.12 * rng.standard_normal(len(t)) for c in "abcdef"}
    coarse = np.round((90 + 0.1 * t + 0.02 * rng.standard_normal(len(t))) / 0.21) * 0.21
    said = {}
    for name, columns in (("fine", fine), ("coarse", {**fine, "fast_e_degC": coarse})):
        frame = pd.DataFrame({"time_s": t, **columns})
        traces = disk_traces(frame, "fast", load_rig(), record, rows=t > 30)
        said[name] = traces.findings
        assert (traces.noise_K > 0.05).all()  # rounding of 0.21 K steps is 0.06 K
        if (
            name == "coarse"
        ):  # a rounding that stands still does not average out: it adds to the line's uncertainty
            assert traces.static_u_K[4] > 0.06 > 0.05 > traces.static_u_K[0]
    assert said["fine"] == ()
    (found,) = said["coarse"]
    assert (found.code, found.subject, found.numbers["channels"]) == (
        "traces.coarse",
        "fast",
        ("e",),
    )
    assert found.numbers["step_K"] == pytest.approx(0.21, rel=1e-3)


@pytest.mark.study
def test_each_channel_goes_through_its_line_and_the_spike_finder_once(
    campaign: Campaign, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Two disks of six channels, although the lags are refined first: that fit's traces are the
    compensator's."""
    calls = {"estimate_and_whiten_noise": 0, "apply_static": 0}

    def counting(name: str) -> None:
        plain = getattr(traces, name)

        def counted(*args: object) -> object:
            calls[name] += 1
            return plain(*args)

        monkeypatch.setattr(traces, name, counted)

    def no_refinement(*_: object) -> object:
        raise InputError("the fit is another test's")

    counting("estimate_and_whiten_noise")
    counting("apply_static")
    monkeypatch.setattr(compensate_stages, "refine_lags", no_refinement)
    done = compensate.compensate_log(campaign.files.ehl["B3"], campaign.records, campaign.rig)
    assert calls == {"estimate_and_whiten_noise": 2, "apply_static": 12}
    assert any("the fit is another test's" in w for w in done.warnings)
