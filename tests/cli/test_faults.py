"""What a machine does to files: full disks, flipped bits, links, names; and what nobody caught is
one sentence."""

from __future__ import annotations

import errno
import json
import resource
from collections.abc import Callable
from pathlib import Path
from typing import Any, cast

import numpy as np
import pandas as pd
import pytest

from tcdyn.campaign.stored_results import read_result
from tcdyn.cli.app import run
from tcdyn.core.errors import InputError
from tcdyn.io.checksum import ALTERED_CODE, with_checksum
from tcdyn.io.stored import BETA
from tcdyn.io.write import log_writer, write_log, write_text
from tcdyn.rig.record import read_record
from tcdyn.sensors import read_sensor, specified_sensor, write_sensor


@pytest.mark.parametrize("ending", [".csv", ".parquet", ".xlsx", ".nc", ".tdms", ".txt"])
def test_a_full_disk_leaves_the_old_file_and_is_told(tmp_path: Path, ending: str) -> None:
    frame = pd.DataFrame(
        {"time_s": np.arange(20_000.0), "a": np.random.default_rng(0).standard_normal(20_000)}
    )
    target, soft = tmp_path / f"out{ending}", resource.getrlimit(resource.RLIMIT_FSIZE)

    def pieces() -> None:
        with log_writer(target, ["time_s", "a"], {}) as write:
            for start in range(0, len(frame), 1000):
                write(frame[start : start + 1000])

    ways: list[Callable[[], object]] = [lambda: write_log(frame, target), pieces]
    if ending in (".tdms", ".txt"):
        ways = ways[:1] if ending == ".tdms" else [lambda: write_text(target, "x" * 300_000)]
    for way in ways:
        for room in (0, 1, 1000, 70_000, 150_000):
            target.write_text("old", encoding="utf-8")
            try:
                resource.setrlimit(resource.RLIMIT_FSIZE, (room, soft[1]))
                with pytest.raises(InputError, match="cannot be written"):
                    way()
            finally:
                resource.setrlimit(resource.RLIMIT_FSIZE, soft)
            assert target.read_text(encoding="utf-8") == "old"
            assert list(tmp_path.iterdir()) == [target]
        way()
        assert target.stat().st_size > 150_000


@pytest.mark.e2e
@pytest.mark.parametrize("kind", ["sensor", "record", "answer"])
def test_a_flipped_bit_of_a_stored_file_is_told_or_changes_nothing(
    tmp_path: Path, kind: str, campaign: Any
) -> None:
    rng, path, read = (
        np.random.default_rng(0),
        tmp_path / "stored.json",
        cast(Callable[[Path], Any], read_sensor),
    )
    if kind == "sensor":
        write_sensor(specified_sensor("s", ["T1"], [(0.5, 0.02)]), path)
    elif kind == "record":
        read = read_record
        path.write_bytes(campaign.record_paths["fast"].read_bytes())
    else:
        read = read_result
        content = {"schema": BETA.schema, "status": "sound", "beta": rng.normal(size=50)}
        path.write_text(json.dumps(with_checksum(content)), encoding="utf-8")
    whole, sound, said = path.read_bytes(), read(path), []
    for _ in range(500):
        damaged = bytearray(whole)
        damaged[rng.integers(len(whole))] ^= 1 << rng.integers(8)
        path.write_bytes(damaged)
        try:
            found = read(path)
            assert found == sound or ALTERED_CODE in [f.code for f in found.findings], bytes(
                damaged
            )
        except (InputError, ValueError) as problem:
            said.append(str(problem))
    assert not any("\n" in sentence for sentence in said)
    assert len(said) > 250  # the others are spaces between keys, and digits beyond a double's


def test_links_are_written_through_and_devices_are_spared(tmp_path: Path) -> None:
    real, link = tmp_path / "real.csv", tmp_path / "link.csv"
    real.write_text("old", encoding="utf-8")
    link.symlink_to(real)
    write_text(link, "new")
    assert link.is_symlink()
    assert real.read_text(encoding="utf-8") == "new"
    with pytest.raises(InputError, match="device"):
        write_text("/dev/null", "new")
    link.unlink()
    link.symlink_to(link)  # a circle
    with pytest.raises(InputError, match="cannot be written"):
        write_text(link, "new")


def test_names_with_commas_quotes_and_control_characters_come_back(tmp_path: Path) -> None:
    names = ["time_s", 'a,"b"_degC', "$x_degC", "=1+1_degC"]
    frame = pd.DataFrame(np.arange(12.0).reshape(3, 4), columns=names)
    notes = {"who": "a\x1b[31m\nb"}
    for path in (write_log(frame, tmp_path / "whole.csv", notes), tmp_path / "parts.csv"):
        if not path.exists():
            with log_writer(path, names, notes) as put:
                put(frame)
        text = path.read_text(encoding="utf-8")
        assert "\x1b" not in text
        # a spreadsheet would compute the last one
        assert list(pd.read_csv(path).columns) == [*names[:3], "'=1+1_degC"]


@pytest.mark.parametrize(
    ("problem", "said"),
    [
        (MemoryError(), "not enough memory"),
        (
            ImportError("x.so: failed to map segment"),
            "the system refused (x.so: failed to map segment)",
        ),
        (RecursionError("maximum recursion depth exceeded"), "nested too deeply"),
        (OverflowError("int too large"), "beyond all bounds"),
        (OSError(errno.EIO, "Input/output error", "log.csv"), "log.csv: the system refused"),
    ],
)
def test_what_nobody_caught_is_one_sentence(
    problem: Exception, said: str, capsys: pytest.CaptureFixture[str]
) -> None:
    def command() -> None:
        raise problem

    assert run(command) == 2
    err = capsys.readouterr().err
    assert said in err
    assert err.count("\n") == 1
