"""No command writes over what it reads, nor two of its outputs onto one file; what it has written
when it ends."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from tests.cli.test_main_job import records, tcdyn
from tests.conftest import Campaign


@pytest.fixture
def files(campaign: Campaign, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> dict[str, Path]:
    """Inputs by short names, a folder below the present one to reach them by another way."""
    monkeypatch.chdir(tmp_path)
    f = campaign.files
    sources = {
        "log": f.ehl["B3"],
        "oven": f.ovens["fast"],
        "plunge": f.plunges["fast"][0],
        "rig": f.rig,
    }
    found = {}
    for name, source in sources.items():
        found[name] = Path("..") / tmp_path.name / source.name
        found[name].write_bytes(source.read_bytes())
    return found


@pytest.mark.e2e
@pytest.mark.parametrize(
    ("words", "spared"),
    [
        ("compensate {log} {records} --out EHL_B3.csv", "log"),
        ("compensate {log} {records} --out EHL_B3.csv --method noise-only", "log"),
        ("compensate {log} {records} --covariance EHL_B3.csv", "log"),
        ("follow {log} {records} --out EHL_B3.csv", "log"),
        ("compensate {log} {records} --report EHL_B3.csv", "log"),
        ("compensate {log} {records} --rig {rig} --report rig.toml", "rig"),
        (
            "rig calibrate --disk fast --oven {oven} --immersion {plunge} --out oven_fast.csv",
            "oven",
        ),
        (
            "rig calibrate --disk fast --oven {oven} --immersion {plunge} --report "
            "plunge_fast_1.csv",
            "plunge",
        ),
        (
            "rig calibrate --disk fast --oven {oven} --immersion {plunge} --rig {rig} --out "
            "rig.toml",
            "rig",
        ),
        (
            "rig calibrate --disk fast --oven {oven} --immersion {plunge} --fluid {log} --out "
            "EHL_B3.csv",
            "log",
        ),
        (
            "rig calibrate --disk fast --oven {oven} --immersion {plunge} --out x.json "
            "--report x.json",
            "oven",
        ),
        ("identify {plunge} --input probe_degC --output a_degC --out plunge_fast_1.csv", "plunge"),
        ("identify {plunge} --input probe_degC --output a_degC --out x.html", "plunge"),
        ("rig holes {log} --out EHL_B3.csv", "log"),
        ("rig holes {log} --rig {rig} --report rig.toml", "rig"),
        ("rig design --rig {rig} --out rig.toml", "rig"),
        ("rig design --fluid {oven} --out oven_fast.csv", "oven"),
        ("verify --out x --report x", "log"),
    ],
)
def test_an_input_is_never_written_over(
    words: str,
    spared: str,
    files: dict[str, Path],
    campaign: Campaign,
    capsys: pytest.CaptureFixture[str],
) -> None:
    before = {p.name: p.read_bytes() for p in Path().iterdir()}
    said = words.format(records=" ".join(map(str, records(campaign))), **files).split()
    assert tcdyn(*said) == 2
    error = capsys.readouterr().err
    assert "would write over" in error
    assert error.count("\n") == 1
    assert {p.name: p.read_bytes() for p in Path().iterdir()} == before, spared


@pytest.mark.e2e
def test_a_command_that_ends_has_written_all_and_tells_its_status(tmp_path: Path) -> None:
    command = [sys.executable, "-m", "tcdyn"]
    told = subprocess.run([*command, "verify", "--json"], stdout=subprocess.PIPE, check=True).stdout
    assert json.loads(told)
    absent = subprocess.run(
        [*command, "rig", "check", "absent.toml"], stderr=subprocess.PIPE, cwd=tmp_path
    )
    assert (absent.returncode, absent.stderr.count(b"\n")) == (2, 1)
    for does, status, said in (
        ("atexit.register(print, 'late') and 1", 1, "late"),  # what libraries do at the end is done
        ("print('x' * 10**6)", 0, "x" * 10**6),
        ("sys.exit()", 0, ""),
    ):
        code = (
            f"import atexit, sys; import tcdyn.cli.app as a; a.run = lambda _: {does} "
            "or 0; a.main()"
        )
        done = subprocess.run(
            [sys.executable, "-c", code], capture_output=True, text=True, check=False
        )
        assert done.returncode == status
        assert (done.stdout + done.stderr).endswith(f"{said}\n" if said else "")


@pytest.mark.e2e
def test_a_script_that_calls_a_command_goes_on_and_ends_as_it_says(tmp_path: Path) -> None:
    code = (
        "import sys; from tcdyn.cli.app import main; sys.argv = ['tcdyn', '--version']\n"
        "try: main()\nexcept SystemExit as ended: assert ended.code == 0\n"
        "kept = open('late.txt', 'w'); kept.write('data'); sys.exit(3)"
    )
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, cwd=tmp_path, check=False
    )
    assert (done.returncode, done.stderr, (tmp_path / "late.txt").read_text()) == (3, "", "data")


@pytest.mark.e2e
@pytest.mark.skipif(sys.platform != "linux", reason="a device that is always full")
@pytest.mark.parametrize("words", [pytest.param("verify", marks=pytest.mark.long), "rig check"])
def test_an_output_that_takes_nothing_is_told_of(words: str) -> None:
    """``verify`` writes at once, ``rig`` when it ends."""
    command = [sys.executable, "-m", "tcdyn", *words.split()]
    with Path("/dev/full").open("wb") as full:
        done = subprocess.run(command, stdout=full, stderr=subprocess.PIPE)
    assert (done.returncode, done.stderr.count(b"\n")) == (2, 1)


@pytest.mark.e2e
@pytest.mark.skipif(sys.platform == "win32", reason="a closed pipe of POSIX")
@pytest.mark.parametrize("words", ["rig check", "--help"])
def test_a_reader_that_closes_its_end_of_the_pipe_is_no_error(words: str) -> None:
    reader, writer = os.pipe()
    os.close(reader)
    try:
        command = [sys.executable, "-m", "tcdyn", *words.split()]
        done = subprocess.run(command, stdout=writer, stderr=subprocess.PIPE)
    finally:
        os.close(writer)
    assert (done.returncode, done.stderr) == (0, b"")


@pytest.mark.e2e
@pytest.mark.skipif(sys.platform == "win32", reason="a signal to a group of processes")
def test_ctrl_c_ends_with_one_line_and_its_code(campaign: Campaign, tmp_path: Path) -> None:
    """Whenever it comes: while libraries are imported, a log is read, or fits are made."""
    log, out = campaign.files.ehl["B3"], tmp_path / "out.json"
    words = [
        sys.executable,
        "-m",
        "tcdyn",
        "rig",
        "beta",
        log,
        *records(campaign),
        "--out",
        out,
        "-q",
    ]
    for wait_s in (1.0, 2.5, 4.0):
        run = subprocess.Popen(
            [*map(str, words)], stderr=subprocess.PIPE, text=True, start_new_session=True
        )
        time.sleep(wait_s)
        if run.poll() is None:
            os.killpg(run.pid, signal.SIGINT)
        said = run.communicate(timeout=60)[1]
        # Python itself ends by the signal where Ctrl-C came while a library executed text as code
        # (dataclasses do, at import), whatever the exit code; a shell shows 130 for both
        stopped = run.returncode in (130, -signal.SIGINT)
        told = "tcdyn: stopped; nothing half-written was kept\n" if stopped else ""
        # while libraries are imported the signal ends the process as it is, without a word
        assert said == told or (run.returncode == -signal.SIGINT and said == "")
        assert stopped or run.returncode == 0
        assert not [*tmp_path.glob("*.tmp*")]
