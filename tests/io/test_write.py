"""Outputs appear whole or not at all."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from tcdyn.core.errors import InputError
from tcdyn.io.read import sha256_of_file
from tcdyn.io.write import OutputStyle, atomic_path, write_text
from tcdyn.rig.log import write_log
from tests.rig.log_cases import ehl_frame

WRITER = """
import sys
import numpy as np, pandas as pd
from tcdyn.rig.log import write_log
frame = pd.DataFrame({f"c{i}": np.arange(400_000.0) + i for i in range(8)})
print("ready", flush=True)
while True:
    write_log(frame, sys.argv[1])
"""


@pytest.mark.e2e
@pytest.mark.parametrize(
    ("ending", "before"), [("csv", True), ("csv", False), ("parquet", True), ("tdms", False)]
)
def test_killing_the_writer_leaves_the_previous_file_or_none(tmp_path, ending, before):
    target = tmp_path / f"out.{ending}"
    good = {len(b"previous")}
    if before:
        target.write_bytes(b"previous")
    for delay in (0.0, 0.05):
        process = subprocess.Popen(
            [sys.executable, "-c", WRITER, str(target)],
            stdout=subprocess.PIPE,
            env={**os.environ, "OMP_NUM_THREADS": "1"},
        )
        assert process.stdout is not None
        process.stdout.readline()
        time.sleep(delay)
        process.send_signal(signal.SIGKILL)
        process.wait()
        process.stdout.close()
        if target.exists() and target.read_bytes() != b"previous":
            good.add(target.stat().st_size)
    # every whole file has one size; a half-written one would have another
    assert len(good) <= 2
    assert [p for p in tmp_path.iterdir() if not p.name.startswith(".")] in ([], [target])


def test_a_failing_writer_leaves_the_previous_file_and_no_litter(tmp_path):
    target = write_text(tmp_path / "a.txt", "old")

    def half():
        with atomic_path(target) as beside:
            beside.write_text("half")
            raise RuntimeError

    with pytest.raises(RuntimeError):
        half()
    assert target.read_text() == "old"
    assert list(tmp_path.iterdir()) == [target]


def test_interrupting_leaves_the_previous_file(tmp_path):
    target = write_text(tmp_path / "a.txt", "old")
    with pytest.raises(KeyboardInterrupt), atomic_path(target):
        raise KeyboardInterrupt
    assert target.read_text() == "old"


def test_unwritable_places_and_unknown_endings_are_refused(tmp_path):
    (tmp_path / "file").write_text("x")
    for place in (tmp_path / "file" / "out.csv", tmp_path, tmp_path / "a\0b.csv"):
        with pytest.raises(InputError):
            write_text(place, "x")
    with pytest.raises(InputError, match=r"\.csv, \.parquet, \.xlsx, \.nc or \.tdms"):
        write_log(ehl_frame(), tmp_path / "out.xls")
    with pytest.raises(InputError, match="not readable"):
        sha256_of_file(tmp_path / "none")


def test_a_hash_is_that_of_the_standards_own_example(tmp_path):
    file = write_text(tmp_path / "abc.txt", "abc")
    assert sha256_of_file(file).startswith("ba7816bf")  # FIPS 180


def test_metadata_cannot_break_out_of_its_line(tmp_path):
    style = OutputStyle(comments=True)
    path = write_log(ehl_frame(), tmp_path / "a.csv", {"note\ntime_s": "1\n2,3"}, style=style)
    assert path.read_text().split("\n")[0] == "# note time_s: 1 2,3"


def test_a_file_is_flushed_through_a_descriptor_that_may_write(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Windows does not flush a file that is open for reading only (EBADF): every write failed."""
    flushed = []

    def flush(descriptor: int) -> None:
        os.write(descriptor, b"")  # EBADF where the descriptor may not write
        flushed.append(descriptor)

    monkeypatch.setattr(os, "fsync", flush)
    write_text(tmp_path / "out.txt", "done")
    assert flushed
    assert (tmp_path / "out.txt").read_text(encoding="utf-8") == "done"


def test_a_file_that_another_program_has_open_stays_as_it_is(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As on Windows, where such a file cannot be replaced."""
    target = write_text(tmp_path / "out.txt", "old")

    def refuse(source: object, target: object) -> None:
        raise PermissionError(13, "Access is denied")

    monkeypatch.setattr(os, "replace", refuse)
    with pytest.raises(InputError, match=r"Access is denied.*close it in other programs"):
        write_text(target, "new")
    assert target.read_text(encoding="utf-8") == "old"
    assert list(tmp_path.iterdir()) == [target]


def test_writing_does_not_change_the_umask_of_the_process(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Two threads that read it by setting it could leave it at zero for all later files."""

    def forbidden(mask: int) -> int:
        raise AssertionError("the umask is set")

    monkeypatch.setattr(os, "umask", forbidden)
    write_text(tmp_path / "out.txt", "new")


@pytest.mark.skipif(os.name == "nt", reason="permissions of POSIX")
def test_a_private_file_is_private_also_while_it_is_replaced(tmp_path: Path) -> None:
    target = write_text(tmp_path / "out.txt", "old")
    target.chmod(0o600)
    with atomic_path(target) as temporary:
        assert temporary.stat().st_mode & 0o777 == 0o600
        temporary.write_text("new", encoding="utf-8")
    assert target.stat().st_mode & 0o777 == 0o600
