"""The examples of docstrings that need a campaign or a long time run in the folder of a
campaign."""

from __future__ import annotations

import doctest
import shutil
from collections.abc import Callable
from pathlib import Path

import pytest

import tcdyn
from tests.conftest import Campaign

FUNCTIONS = [
    tcdyn.calibrate_disk,
    pytest.param(tcdyn.compensate_log, marks=pytest.mark.long),
    pytest.param(tcdyn.estimate_beta, marks=pytest.mark.long),
    tcdyn.iter_log,
    tcdyn.read_record,
    tcdyn.write_record,
    tcdyn.sensor_from_current,
    pytest.param(tcdyn.run_demo, marks=pytest.mark.long),
]


@pytest.mark.e2e
@pytest.mark.parametrize("function", FUNCTIONS, ids=lambda function: function.__name__)
def test_example_that_is_skipped_elsewhere_prints_what_it_shows(
    function: Callable[..., object],
    campaign: Campaign,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    shutil.copytree(campaign.files.folder, tmp_path / "campaign")
    monkeypatch.chdir(tmp_path / "campaign")
    text = (function.__doc__ or "").replace("  # doctest: +SKIP", "")
    names = dict(vars(__import__(function.__module__, fromlist=["x"])))
    test = doctest.DocTestParser().get_doctest(text, names, function.__name__, None, 0)
    assert test.examples
    result = doctest.DocTestRunner(verbose=False).run(test)
    assert result.failed == 0
