"""Which existing file a command replaces, and with which permissions."""

from __future__ import annotations

import os
import stat
from pathlib import Path

import pytest

from tcdyn.cli.identify import _files_of_outputs
from tcdyn.cli.simulate import _check_demo_folder
from tcdyn.core.errors import InputError
from tcdyn.io import write
from tcdyn.io.read import sha256_of_file
from tcdyn.io.write import (
    atomic_path,
    check_may_replace,
    contains_checksum_of,
    removed_on_failure,
    write_text,
)
from tcdyn.rig.rigfile import load_rig
from tcdyn.sensors import read_sensor
from tcdyn.simulate.campaign import simulate_campaign
from tcdyn.workflows import calibrate_disk
from tcdyn.workflows.compensate_table import compensate_table
from tests.cli.fault_commands import small_files
from tests.cli.test_main_job import tcdyn

MINE = "a file of another program"


@pytest.fixture(scope="module")
def world(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """Small inputs of commands, by name."""
    return small_files(tmp_path_factory.mktemp("inputs"))


def words_of(world: dict[str, Path], out: Path) -> dict[str, list[object]]:
    """Commands that write ``out`` in a moment, by name."""
    return {
        "compensate": ["compensate", world["table"], "--sensor", world["sensor"], "--out", out],
        "response": [
            *("response", world["bode"], "--column", "gain", "--column", "phase"),
            *("--model", "P1", "--out", out),
        ],
        "view": ["view", world["table"], "--no-open", "--out", out],
        "transducer": ["rig", "transducer", world["weights"], "--out", out],
    }


@pytest.mark.parametrize(
    ("name", "file"),
    [
        ("compensate", "o.csv"),
        pytest.param("compensate", "o.parquet", marks=pytest.mark.e2e),
        ("compensate", "o.xlsx"),
        pytest.param("compensate", "o.nc", marks=pytest.mark.e2e),
        ("response", "o.json"),
        pytest.param("view", "o.html", marks=pytest.mark.e2e),
        ("transducer", "o.json"),
    ],
)
def test_a_command_replaces_its_own_output_and_no_other_file(
    world: dict[str, Path], tmp_path: Path, name: str, file: str, capsys: pytest.CaptureFixture[str]
) -> None:
    out = write_text(tmp_path / file, MINE)
    words = [*words_of(world, out)[name], "-q"]
    assert tcdyn(*words) == 2
    assert "--overwrite" in capsys.readouterr().err
    assert out.read_text(encoding="utf-8") == MINE
    assert tcdyn(*words, "--overwrite") in (0, 1)
    made = out.read_bytes()
    assert made != MINE.encode()
    assert tcdyn(*words) in (0, 1)
    assert out.exists()


def test_a_result_of_another_input_is_not_replaced(world: dict[str, Path], tmp_path: Path) -> None:
    out = tmp_path / "o.csv"
    words = words_of(world, out)["compensate"]
    assert tcdyn(*words, "-q") in (0, 1)
    before = out.read_bytes()
    other = tmp_path / "other.csv"
    other.write_bytes(world["table"].read_bytes() + b"31,1.0,20.0,20.0\n")
    words[1] = other
    assert tcdyn(*words, "-q") == 2
    assert out.read_bytes() == before


@pytest.mark.parametrize("make", [os.link, os.symlink])
def test_an_output_is_never_an_input_under_another_name(
    world: dict[str, Path], tmp_path: Path, make: object, capsys: pytest.CaptureFixture[str]
) -> None:
    table = tmp_path / "log.csv"
    table.write_bytes(world["table"].read_bytes())
    out = tmp_path / "again.csv"
    make(table, out)  # type: ignore[operator]
    words = ["compensate", table, "--sensor", world["sensor"], "--out", out, "--overwrite", "-q"]
    assert tcdyn(*words) == 2
    assert "which is read" in capsys.readouterr().err
    assert table.read_bytes() == world["table"].read_bytes()


def test_python_functions_do_not_write_over_their_input(
    world: dict[str, Path], tmp_path: Path
) -> None:
    table = tmp_path / "log.csv"
    table.write_bytes(world["table"].read_bytes())
    link = tmp_path / "link.csv"
    link.symlink_to(table)
    with pytest.raises(InputError, match="is the file that is read"):
        compensate_table(table, [read_sensor(world["sensor"])], link)
    assert table.read_bytes() == world["table"].read_bytes()


def test_a_read_only_file_is_not_replaced_even_with_overwrite(
    world: dict[str, Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = write_text(tmp_path / "o.json", MINE)
    out.chmod(0o444)
    words = words_of(world, out)["transducer"]
    assert tcdyn(*words, "--overwrite", "-q") == 2
    assert "read-only" in capsys.readouterr().err
    assert out.read_text(encoding="utf-8") == MINE
    with pytest.raises(InputError, match="read-only"):
        write_text(out, "x")


@pytest.mark.parametrize("mode", [0o600, 0o640, 0o664])
def test_a_replaced_file_keeps_its_permissions_and_a_new_one_has_those_of_the_umask(
    tmp_path: Path, mode: int
) -> None:
    file = write_text(tmp_path / "a.txt", "old")
    file.chmod(mode)
    write_text(file, "new")
    assert stat.S_IMODE(file.stat().st_mode) == mode
    mask = os.umask(0o027)
    try:
        new = write_text(tmp_path / "b.txt", "new")
    finally:
        os.umask(mask)
    assert stat.S_IMODE(new.stat().st_mode) == 0o640


def test_an_empty_file_may_be_replaced(tmp_path: Path) -> None:
    empty = tmp_path / "made_by_mktemp"
    empty.touch()
    check_may_replace(empty, [])
    with pytest.raises(InputError, match="overwrite=True"):
        check_may_replace(write_text(tmp_path / "full", MINE), [empty])


def test_a_command_without_input_says_only_that_the_output_exists(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = write_text(tmp_path / "probe.sensor.json", MINE)
    assert tcdyn("sensor", "new", "--tau-s", "25+-1", "--column", "T", "--out", out) == 2
    error = capsys.readouterr().err
    assert "exists already" in error
    assert "--overwrite" in error
    assert "this input" not in error


def test_a_simulated_log_replaces_a_simulated_one_and_no_measured_one(tmp_path: Path) -> None:
    out = tmp_path / "oven.csv"
    words = ["simulate", "oven", "--out", out, "-q"]
    assert tcdyn(*words, "--seed", 1) == 0
    assert tcdyn(*words, "--seed", 2) == 0
    measured = "setpoint_degC,prt_degC,a_degC\n20,20.1,20.3\n"
    out.write_text(measured, encoding="utf-8")
    assert tcdyn(*words) == 2
    assert out.read_text(encoding="utf-8") == measured


def test_files_of_use_only_together_go_together_if_one_fails(tmp_path: Path) -> None:
    old = write_text(tmp_path / "old.txt", "old")
    new = tmp_path / "new.txt"

    def fail() -> None:
        with removed_on_failure(old, new):
            write_text(new, "x")
            with atomic_path(tmp_path / "third.txt"):
                raise OSError

    with pytest.raises(OSError):
        fail()
    assert list(tmp_path.iterdir()) == [old]


@pytest.mark.e2e
@pytest.mark.parametrize("disk", ["fsat", "../../x", "/tmp/x", "", "fast "])
@pytest.mark.parametrize(
    "words",
    [
        "rig calibrate --immersion {dip} --reading-u-K 1",
        "simulate oven --out o.csv",
        "simulate immersion --out o.csv",
        "rig line {spot}",
        "rig circumference fit --picture o.png",
    ],
)
def test_no_command_makes_a_path_from_an_unknown_disk(
    world: dict[str, Path],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    words: str,
    disk: str,
    capsys: pytest.CaptureFixture[str],
) -> None:
    inner = tmp_path / "a" / "b"
    inner.mkdir(parents=True)
    monkeypatch.chdir(inner)
    assert tcdyn(*words.format(**world).split(), "--disk", disk) == 2
    assert "fast or slow" in capsys.readouterr().err
    assert [path for path in tmp_path.rglob("*") if path.is_file()] == []
    with pytest.raises(InputError, match="fast or slow"):
        calibrate_disk(load_rig(), disk, None, [world["dip"]], ["water"], reading_u_K=1.0)
    with pytest.raises(InputError, match="A1 to D4"):
        simulate_campaign(tmp_path / "lab", tests=[f"../{disk}"])


def test_files_of_several_outputs_stay_in_the_folder(tmp_path: Path) -> None:
    outputs = ["../../T1", "/T 2", "..", "T\x003"]
    files = _files_of_outputs(tmp_path / "a.json", outputs)
    assert {path.parent for path in files.values()} == {tmp_path}
    with pytest.raises(InputError, match="one name"):
        _files_of_outputs(tmp_path / "a.json", ["T 1", "T/1"])


@pytest.mark.parametrize(
    "words",
    [
        ["demo"],
        ["simulate", "campaign"],
        ["rig", "campaign", "log.csv", "--record", "fast.disk.json"],
    ],
)
@pytest.mark.parametrize("is_file", [False, True])
def test_the_folder_of_a_campaign_is_neither_the_root_nor_a_file(
    tmp_path: Path, words: list[str], is_file: bool, capsys: pytest.CaptureFixture[str]
) -> None:
    out = write_text(tmp_path / "o", MINE) if is_file else Path(tmp_path.anchor)
    assert tcdyn(*words, "--out", out) == 2
    expected = "which is not a folder" if is_file else "the root of the file system"
    assert expected in capsys.readouterr().err


@pytest.mark.parametrize("name", ["fast.disk.json", "report.html", "EHL_D4.beta.json"])
def test_the_demo_replaces_no_result_of_its_user(
    tmp_path: Path, name: str, capsys: pytest.CaptureFixture[str]
) -> None:
    mine = write_text(tmp_path / name, MINE)
    assert tcdyn("demo", "--out", tmp_path, "--test", "D4", "-q") == 2
    assert "--overwrite" in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == [mine]


def test_the_demo_may_replace_the_results_of_an_earlier_one(tmp_path: Path) -> None:
    log = write_text(tmp_path / "EHL_B3.csv", "a log")
    write_text(tmp_path / "EHL_B3.beta.json", sha256_of_file(log))
    _check_demo_folder(tmp_path, ("B3",), overwrite=False)
    write_text(log, "another log")
    with pytest.raises(InputError, match="exists already"):
        _check_demo_folder(tmp_path, ("B3",), overwrite=False)
    _check_demo_folder(tmp_path, ("B3",), overwrite=True)


def test_the_checksum_of_an_input_is_found_at_the_end_of_a_large_output(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Parquet has its metadata there."""
    monkeypatch.setattr(write, "SEARCHED_BYTES", 1000)
    log = tmp_path / "log.csv"
    log.write_text("time_s,T_degC\n0,1\n", encoding="utf-8")
    out = tmp_path / "out.parquet"
    out.write_bytes(bytes(300_000) + sha256_of_file(log).encode() + bytes(1000))
    assert contains_checksum_of(out, [log])
    out.write_bytes(bytes(300_000))
    assert not contains_checksum_of(out, [log])
