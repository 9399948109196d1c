"""A disk is named as the rig has it, or refused before anything is written."""

from __future__ import annotations

from pathlib import Path

import pytest

import tcdyn
from tcdyn.cli.app import app, run
from tcdyn.core.errors import InputError
from tests.conftest import Campaign

COMMANDS = {
    "rig calibrate": ("--immersion", "plunge.csv"),
    "rig design": (),
    "rig line": ("spot.csv",),
    "simulate oven": ("--out", "oven.csv"),
    "simulate immersion": ("--out", "plunge.csv"),
    "rig circumference fit": (),
}


@pytest.mark.e2e
@pytest.mark.parametrize("disk", ["fsat", "Fast", "", "../../x"])
@pytest.mark.parametrize("name", [*COMMANDS])
def test_a_command_refuses_an_unknown_disk_and_lists_the_disks(
    name: str,
    disk: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    folder = tmp_path / "a" / "b"
    folder.mkdir(parents=True)
    monkeypatch.chdir(folder)
    arguments = [*name.split(), *COMMANDS[name], "--disk", disk]
    assert run(lambda: app(arguments, standalone_mode=False)) == 2
    assert capsys.readouterr().err == f"tcdyn: --disk is {disk!r}; expected fast or slow\n"
    assert [path for path in tmp_path.rglob("*") if path.is_file()] == []


def test_calibrate_writes_nothing_for_an_unknown_disk_though_all_else_is_right(
    campaign: Campaign,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    folder = tmp_path / "a" / "b"
    folder.mkdir(parents=True)
    monkeypatch.chdir(folder)
    files = campaign.files
    arguments = [
        "rig",
        "calibrate",
        "--rig",
        files.rig,
        "--disk",
        "../../x",
        "--oven",
        files.ovens["fast"],
    ]
    arguments += ["--immersion", files.plunges["fast"][0]]
    assert run(lambda: app([str(a) for a in arguments], standalone_mode=False)) == 2
    assert "expected fast or slow" in capsys.readouterr().err
    assert [path for path in tmp_path.rglob("*") if path.is_file()] == []


def test_python_refuses_an_unknown_disk(campaign: Campaign) -> None:
    files = campaign.files
    with pytest.raises(InputError, match=r"'fsat'.*fast or slow"):
        tcdyn.calibrate_disk(
            campaign.rig, "fsat", files.ovens["fast"], files.plunges["fast"], ["mobil-jet-ii"]
        )
    with pytest.raises(InputError, match=r"'fsat'.*fast or slow"):
        campaign.rig.disk_setup("fsat")
    with pytest.raises(InputError, match=r"'fsat'.*fast or slow"):
        tcdyn.read_log(files.plunges["fast"][0], "immersion", campaign.rig, "fsat")
