"""No command writes a file whose ending promises another kind: refused before any work, exit 2."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

import tcdyn as package
from tcdyn.cli import common
from tcdyn.core.errors import InputError
from tcdyn.io.endings import CSV_OR_PAGE, JSON, LONG_TABLE, PAGE, PICTURE, TABLE, FileKind
from tcdyn.report.page import write_page
from tcdyn.rig.record import read_record, write_record
from tcdyn.sensors import specified_sensor, write_sensor
from tcdyn.workflows.compensate_table import compensate_table
from tcdyn.workflows.follow import follow
from tests.cli.test_main_job import tcdyn
from tests.cli.test_options import ALL, _kind_of
from tests.conftest import RECORDS

# Parameters that name files to read. Every other parameter that is a path is an output: a new one
# that is read must be named here, or the test below calls it with an ending that nothing has.
READ = {
    "--record",
    "--sensor",
    "--rig",
    "--immersion",
    "--oven",
    "--earlier",
    "--bearing",
    "--curve",
    "--compare",
    "--campaign",
}
# Outputs that are folders.
FOLDERS = {"demo --out", "rig campaign --out", "simulate campaign --out"}
# Options without which a command does not know what to do.
NEEDED = {
    "compensate": ["--record", "absent.disk.json"],
    "follow": ["--record", "absent.disk.json", "--out", "live.csv"],
    "compensate --results": ["--sensor", "absent.sensor.json", "--each"],
    "sensor plunge --results": ["--each"],
    "sensor noise --results": ["--each"],
    "response": ["--column", "magnitude", "--column", "phase"],
    "rig calibrate": ["--disk", "fast"],
}
NO_KIND = ".xyz"
KNOWN_ENDINGS = (".csv", ".parquet", ".tdms", ".json", ".html", ".png", ".pdf", ".xlsx", ".txt")
VALUES = {"pathlib.Path": "absent.csv", "float": "1", "int": "1", "str": "x"}


def _outputs() -> list[tuple[str, str]]:
    """Every command with each of its options that name a file to write."""
    found = []
    for name, command in ALL.items():
        for parameter in command.params:
            option = parameter.opts[0]
            is_path = _kind_of(parameter) == "pathlib.Path" and option.startswith("--")
            if is_path and option not in READ and f"{name} {option}" not in FOLDERS:
                found.append((name, option))
    return found


def _call(name: str, option: str, value: str) -> list[str]:
    """Words that call a command with absent inputs and one output."""
    words = [*name.split(), *NEEDED.get(f"{name} {option}", NEEDED.get(name, []))]
    for parameter in ALL[name].params:
        opt = parameter.opts[0]
        if not parameter.required or opt == option or opt in words:
            continue
        text = VALUES[_kind_of(parameter)]
        if opt == "--picture":
            text = "picture.png"
        words += [opt, text] if opt.startswith("--") else [text]
    return [*words, option, value]


@pytest.fixture
def checked(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> dict[str, FileKind]:
    """Kind of each output that the commands check, by its option; in an empty folder."""
    kinds: dict[str, FileKind] = {}
    check_ending = common.check_ending

    def spy(path: Any, kind: FileKind, option: str = "") -> None:
        kinds[option] = kind
        check_ending(path, kind, option)

    monkeypatch.setattr(common, "check_ending", spy)
    monkeypatch.chdir(tmp_path)
    return kinds


@pytest.mark.e2e
@pytest.mark.parametrize(("name", "option"), _outputs())
def test_every_output_refuses_an_ending_of_another_kind_before_any_work(
    name: str, option: str, checked: dict[str, FileKind], capsys: pytest.CaptureFixture[str]
) -> None:
    """The inputs are absent, so that a command that reads them first fails in another way."""
    assert tcdyn(*_call(name, option, f"x{NO_KIND}")) == 2
    kind = checked[option]
    error = capsys.readouterr().err
    assert NO_KIND in error
    assert all(ending in error for ending in kind.endings)
    for ending in KNOWN_ENDINGS:
        if ending in kind.endings:
            continue
        assert tcdyn(*_call(name, option, f"x{ending}")) == 2
        assert option in capsys.readouterr().err
    assert list(Path().iterdir()) == []


@pytest.mark.parametrize(
    ("name", "option", "kind"),
    [
        ("view", "--out", PAGE),
        ("identify", "--out", JSON),
        ("identify", "--report", PAGE),
        ("rig beta", "--report", PAGE),
        ("compensate", "--out", TABLE),
        ("compensate", "--covariance", JSON),
        ("follow", "--state", JSON),
        ("rig design", "--out", CSV_OR_PAGE),
        ("sensor touch", "--picture", PICTURE),
    ],
)
def test_an_output_has_the_kind_that_its_command_writes(
    name: str, option: str, kind: FileKind, checked: dict[str, FileKind]
) -> None:
    assert tcdyn(*_call(name, option, f"x{NO_KIND}")) == 2
    assert checked[option] == kind


def test_a_table_of_a_sensor_is_written_in_parts_so_not_as_tdms(
    checked: dict[str, FileKind],
) -> None:
    words = ["compensate", "absent.csv", "--sensor", "absent.sensor.json", "--out", "x.tdms"]
    assert tcdyn(*words) == 2
    assert checked["--out"] == LONG_TABLE


@pytest.mark.parametrize(
    ("kind", "name", "fits"),
    [
        (PAGE, "x.HTML", True),
        (PAGE, "x.htm", True),
        (PAGE, "x", True),
        (PAGE, "x.html.png", False),
        (JSON, "x", True),
        (JSON, "probe_0.5mm", False),
        (TABLE, "x", False),
        (PICTURE, "x", False),
    ],
)
def test_case_does_not_matter_and_a_name_without_ending_promises_nothing(
    kind: FileKind, name: str, fits: bool
) -> None:
    assert kind.fits(name) == fits


def test_functions_refuse_a_name_of_another_kind_and_write_nothing(tmp_path: Path) -> None:
    sensor = specified_sensor("probe", ["T1"], [(1.5, 0.1)])
    log = tmp_path / "log.csv"
    log.write_text("time_s,T1\n" + "".join(f"{k},20\n" for k in range(99)), encoding="utf-8")
    picture = tmp_path / "x.png"
    calls = [
        lambda: write_page(picture, "title", []),
        lambda: write_sensor(sensor, picture),
        lambda: write_record(read_record(RECORDS / "fast.disk.json"), picture),
        lambda: package.view(log, out=picture, open_browser=False),
        lambda: compensate_table(log, [sensor], picture),
        lambda: follow(log, [sensor], picture),
        lambda: follow(log, [sensor], tmp_path / "x.csv", state=picture),
    ]
    for call in calls:
        with pytest.raises(InputError, match=r"x\.png"):
            call()
    assert [path.name for path in tmp_path.iterdir()] == ["log.csv"]
