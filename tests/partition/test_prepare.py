"""What a record gives to the fits, and a rig file that contradicts it."""

from __future__ import annotations

from dataclasses import replace

import pytest

from calibration.disk import Conditioning
from calibration.errors import InputError
from calibration.record import DiskRecord
from calibration.rigfile import load_rig
from tcdyn.partition.prepare import record_chains
from tcdyn.rig.truth import draw_truth
from tests.partition.study_rigs import _record


@pytest.fixture(scope="module")
def record() -> DiskRecord:
    return _record(1, "fast", draw_truth(1), load_rig(), 0.0)


def test_chains_of_a_record_have_the_lags_that_it_states(record: DiskRecord) -> None:
    assert record.chain is not None
    for chain, channel in zip(record_chains(record, load_rig().disk_setup("fast")), "abcdef", strict=True):
        assert chain.lag_s == pytest.approx(record.chain.channels[channel].lag_s.value, abs=1e-9)  # rounding


def test_a_rig_file_with_another_filter_is_refused(record: DiskRecord) -> None:
    """A 10 Hz filter beside a record made with 4 Hz would take 48 ms off every lag, and nobody would notice."""
    setup = replace(load_rig().disk_setup("fast"), conditioning=Conditioning(10.0, 2))
    with pytest.raises(InputError, match="made with conditioning of 2 pole"):
        record_chains(record, setup)
