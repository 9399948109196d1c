"""Options of calibration, heat partition and campaign: the same in the functions and commands."""

from __future__ import annotations

import pickle
from collections.abc import Callable
from dataclasses import fields
from pathlib import Path
from typing import Any

import pytest

from tcdyn.core.arguments import UnknownKeywordError
from tcdyn.core.errors import InputError
from tcdyn.core.options import Options
from tcdyn.rig.rigfile import load_rig
from tcdyn.workflows import calibrate_disk, estimate_beta
from tcdyn.workflows.beta import estimate_stages
from tcdyn.workflows.campaign import run_campaign
from tcdyn.workflows.campaign_log import CampaignSettings
from tcdyn.workflows.rig_options import (
    AnalysisOptions,
    BetaOptions,
    CalibrateOptions,
    CampaignOptions,
)
from tests.cli.test_campaign_command import bearing_csv
from tests.cli.test_main_job import tcdyn
from tests.cli.test_options import ALL

MISSING = Path("missing.csv")


@pytest.mark.parametrize(
    ("command", "group"),
    [
        ("rig beta", BetaOptions),
        ("rig campaign", CampaignOptions),
        ("rig calibrate", CalibrateOptions),
    ],
)
def test_a_command_has_the_options_of_its_function(command: str, group: type[Options]) -> None:
    names = {parameter.name for parameter in ALL[command].params}
    assert {each.name for each in fields(group)} <= names


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (
            lambda: estimate_beta(MISSING, load_rig(), {}, windows_s=4.0),
            "estimate_beta() got an unexpected keyword argument 'windows_s'",
        ),
        (
            lambda: estimate_stages(MISSING, load_rig(), {}, windows_s=4.0),
            "estimate_stages() got an unexpected keyword argument 'windows_s'",
        ),
        (
            lambda: run_campaign([MISSING], load_rig(), {}, "results", windows_s=4.0),
            "run_campaign() got an unexpected keyword argument 'windows_s'",
        ),
        (
            lambda: calibrate_disk(load_rig(), "fast", None, [], ["water"], structures="P1"),
            "calibrate_disk() got an unexpected keyword argument 'structures'",
        ),
        (lambda: estimate_beta(MISSING, load_rig(), {}, window_s=0), "window_s is 0"),
        (lambda: estimate_beta(MISSING, load_rig(), {}, stage=0), "stage is 0"),
        (
            lambda: calibrate_disk(load_rig(), "fast", None, [], ["water"], structure="P9"),
            "structure is 'P9'; expected P1 or P2",
        ),
    ],
)
def test_a_function_refuses_what_is_no_option_before_it_reads_anything(
    call: Callable[[], Any], message: str
) -> None:
    with pytest.raises((InputError, UnknownKeywordError)) as caught:
        call()
    assert str(caught.value).startswith(message)
    if "unexpected keyword" in message:
        assert "did you mean" in str(caught.value)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"workers": 2, "dask": "tcp://127.0.0.1:9"}, "workers is given with dask"),
        ({"interchanged": ["slow_a"]}, "interchanged has 1 junction(s)"),
        ({"workers": 0}, "workers is 0"),
        ({"workers": 257}, "workers is 257"),
        ({"seed": -1}, "seed is -1"),
    ],
)
def test_options_of_a_campaign_that_cannot_be(
    options: dict[str, Any], message: str, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(InputError) as caught:
        CampaignOptions(**options)
    assert str(caught.value).startswith(message)
    words: list[object] = ["rig", "campaign", MISSING, "--record", "fast.disk.json", "--out", "r"]
    for name, value in options.items():
        for each in value if isinstance(value, list) else [value]:
            words += [f"--{name}", each]
    assert tcdyn(*words) == 2
    said = capsys.readouterr().err
    assert said.startswith(f"tcdyn: --{message.split()[0]}")
    assert said.count("\n") == 1


def test_worker_processes_by_default_are_at_most_two() -> None:
    assert CampaignOptions().n_workers in (1, 2)
    assert CampaignOptions(workers=5).n_workers == 5
    assert CampaignOptions(dask="tcp://127.0.0.1:9").n_workers == 1


def test_the_pure_rolling_test_is_read_once_for_all_logs(tmp_path: Path) -> None:
    path = bearing_csv(tmp_path / "bearing.csv")
    options = CampaignOptions(bearing=path, window_s=4.0, workers=2)
    of_log = options.of_analysis
    assert of_log.window_s == 4.0
    path.unlink()
    bearing = of_log.bearing_file
    assert bearing is not None
    settings = pickle.loads(pickle.dumps(CampaignSettings(load_rig(), {}, of_log)))
    assert settings.fingerprint()["bearing_sha256"] == bearing.sha256
    without = CampaignSettings(load_rig(), {}, AnalysisOptions(window_s=4.0))
    assert settings.fingerprint() != without.fingerprint()
    with pytest.raises(InputError, match="no such file"):
        _ = options.bearing_file
