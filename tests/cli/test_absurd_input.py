"""Files nested without end, numbers beyond reason, files that unpack to gigabytes, names that mean
more."""

from __future__ import annotations

import json
import time
from pathlib import Path

import numpy as np
import pandas as pd
import pyarrow as pa
import pytest
from matplotlib.figure import Figure
from pyarrow import parquet as pq

from tcdyn.campaign.tables import TEX
from tcdyn.core.errors import InputError
from tcdyn.io.read import MAX_COLUMNS, open_table
from tcdyn.report.page import Section, figure_data_uri, render_page
from tests.cli.fault_commands import small_files
from tests.cli.test_main_job import tcdyn

DEEP = 100_000
DIGITS = "1" + "0" * 5000
JSON = {
    "lists": "[" * DEEP + "]" * DEEP,
    "tables": '{"a":' * DEEP + "1" + "}" * DEEP,
    "open": "[" * DEEP,
    "digits": f'{{"schema":{DIGITS}}}',
    "no object": "[1]",
}
TOML = {
    "lists": "a=" + "[" * DEEP + "]" * DEEP,
    "tables": "a=" + "{a=" * DEEP + "1" + "}" * DEEP,
    "dots": ".".join(["a"] * DEEP) + "=1",
    "header": "[" + " . ".join(['"a"'] * DEEP) + "]",
    "digits": f"[disk]\nwidth_mm={DIGITS}",
    "infinite": "[disk]\nwidth_mm=1e400",
    "nan": "[disk]\nwidth_mm=nan",
    "name": '[disk]\n"a\\u001b[31m\\nb"=1',
    "long": "[disk]\nwidth_mm=1" + "0" * 400,
}


@pytest.fixture(scope="module")
def world(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    return small_files(tmp_path_factory.mktemp("world"))


def one_sentence(capsys: pytest.CaptureFixture[str], *words: object) -> str:
    """The sentence of a command that has to refuse within seconds."""
    capsys.readouterr()
    begun = time.monotonic()
    assert tcdyn(*words) == 2
    shown = capsys.readouterr().err.splitlines(keepends=True)
    said = "".join(line for line in shown if not line.startswith("... "))  # without the progress
    assert time.monotonic() - begun < 20
    assert said.startswith("tcdyn: ")
    assert (said.count("\n"), said.isascii() and said[:-1].isprintable()) == (1, True)
    assert len(said) < 600
    return said


@pytest.mark.parametrize("kind", TOML)
def test_a_rig_file_beyond_reason(
    kind: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "rig.toml"
    path.write_text(TOML[kind], encoding="utf-8")
    assert "rig.toml: " in one_sentence(capsys, "rig", "check", path)


@pytest.mark.e2e
@pytest.mark.parametrize("kind", JSON)
def test_stored_files_beyond_reason(
    kind: str, world: dict[str, Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path, out = tmp_path / "EHL.beta.json", tmp_path / "o.csv"
    path.write_text(JSON[kind], encoding="utf-8")
    follow = (
        "--sensor",
        world["sensor"],
        "--out",
        out,
        "--state",
        path,
        "--idle-s",
        "0",
        "--delay-s",
        "2",
        "-q",
    )
    for words in (
        ("rig", "record", "show", path),
        ("sensor", "show", path),
        ("compensate", world["table"], "--sensor", path),
        ("compensate", world["table"], "--record", path),
        ("follow", world["table"], *follow),
    ):
        assert "EHL.beta.json: " in one_sentence(capsys, *words)
    assert not out.exists()


@pytest.mark.parametrize("kind", ["lists", "digits", "no object"])
def test_an_answer_or_a_truth_beyond_reason(kind: str, tmp_path: Path) -> None:
    from tcdyn.campaign.stored_results import is_altered, read_given_result
    from tcdyn.simulate.campaign import simulate_campaign

    path = tmp_path / "EHL_B3.beta.json"
    path.write_text(JSON[kind], encoding="utf-8")
    with pytest.raises(InputError, match="EHL_B3"):
        read_given_result(path, "", "")
    assert is_altered(path) == ('"sha256"' in JSON[kind])
    (tmp_path / "truth").mkdir()
    (tmp_path / "truth" / "truth.json").write_text(JSON[kind], encoding="utf-8")
    (tmp_path / "rig.toml").write_text("[disk]\nwidth_mm = 9.1\n", encoding="utf-8")
    with pytest.raises(InputError, match="no simulation wrote"):
        simulate_campaign(tmp_path, 0)


@pytest.mark.e2e
@pytest.mark.parametrize("number", ["1e400", "nan", "1e308", "1e-308", DIGITS])
@pytest.mark.parametrize(
    "words",
    [
        "sensor new --column T1 --out {o} --tau-s",
        "sensor new --column T1 --tau-s 1 --out {o} --dead-time-s",
        "sensor plunge {dip} --column T1 --out {o} --medium-s",
        "sensor plunge {dip} --column T1 --out {o} --entry-s",
        "identify {table} --input u --output T1_degC --out {o} --input-noise",
        "sensor pair {table} --column T1_degC --column T2_degC --speed u --out {o} --exponent",
    ],
)
def test_a_number_beyond_reason(
    words: str,
    number: str,
    world: dict[str, Path],
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    if number == "1e-308" and ("entry" in words or "delay" in words or "medium" in words):
        number = "-1e308"
    one_sentence(capsys, *words.format(**world, o=tmp_path / "o.json").split(), number)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.e2e
@pytest.mark.parametrize(
    "words",
    [
        "rig beta x --record y --window-s",
        "rig campaign x --record y --out z --window-s",
        "rig design --noise-K",
        "rig design --entry-u-s",
        "identify x -u a -y b --dt-s",
        "identify x -u a -y b --resample-s",
        "identify x -u a -y b --cutoff-Hz",
        "identify x -u a -y b --gain",
        "sensor new --tau-s 1 --column T1 --out o.json --cutoff-Hz",
    ],
)
def test_an_option_names_its_bounds(words: str, capsys: pytest.CaptureFixture[str]) -> None:
    for number in ("inf", "nan", "-1e308", *(["1e-308"] if "window" not in words else [])):
        assert f"{words.split()[-1]} is " in one_sentence(capsys, *words.split(), number)


@pytest.mark.e2e
def test_a_file_that_unpacks_to_gigabytes_is_refused_by_a_limit_that_is_told(
    world: dict[str, Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    rows, path = 5_000_000, tmp_path / "bomb.parquet"
    same = pa.table({"time_s": np.zeros(rows), "T1_degC": np.full(rows, 20.0)})
    with pq.ParquetWriter(path, same.schema, compression="zstd") as put:
        for _ in range(20):
            put.write_table(same, row_group_size=rows)
    assert path.stat().st_size < 2_000_000
    said = one_sentence(capsys, "compensate", path, "--sensor", world["sensor"])
    assert "promises 100000000 rows of 2 columns, 1.6 GB" in said
    assert "at most 200 times" in said
    frame = pa.table({"time_s": np.arange(10.0), "T1_degC": ["x" * 1_000_000] * 10})
    pq.write_table(frame, path)
    assert "a cell of 1000000 bytes; expected at most 1000" in one_sentence(
        capsys, "compensate", path, "--sensor", world["sensor"]
    )


def test_a_table_has_a_bounded_number_of_columns(tmp_path: Path) -> None:
    for many in (MAX_COLUMNS, MAX_COLUMNS + 1):
        path = tmp_path / "wide.parquet"
        pq.write_table(pa.table({f"c{i}": [1.0] for i in range(many)}), path)
        if many == MAX_COLUMNS:
            assert len(open_table(path).names) == many
        else:
            with pytest.raises(
                InputError, match=f"has {many} columns; expected at most {MAX_COLUMNS}"
            ):
                open_table(path)


def test_text_and_categories_of_parquet_are_read_as_before(tmp_path: Path) -> None:
    path = tmp_path / "log.parquet"
    values = pd.Categorical(["1.5", "2.5", "1.5"])
    pd.DataFrame({"time_s": [0.0, 1.0, 2.0], "a": ["1", "", "3"], "b": values}).to_parquet(path)
    found = next(part.data for part in open_table(path).chunks(["a", "b"], 10))
    assert np.array_equal(found["a"], [1.0, np.nan, 3.0], equal_nan=True)
    assert found["b"].tolist() == [1.5, 2.5, 1.5]


NAMES = (
    "$x^{2$",
    "=1+1",
    "a\x1b[31mb",
    "<script>alert(1)</script>",
    "back\\slash\\frac{",
    "two\nlines",
)


def test_names_are_only_names_in_pictures_pages_and_latex() -> None:
    figure = Figure()
    ax = figure.subplots()
    for k, name in enumerate(NAMES):
        ax.semilogy([1, 2], [1e-3 * (k + 1), 10.0], label=name)
    ax.set(title=" ".join(NAMES), xlabel=NAMES[0], ylabel=NAMES[2])
    ax.legend()
    uri = figure_data_uri(figure)  # a warning of a sign without a picture would be an error
    assert len(uri) > 5000
    assert [t.get_text() for t in ax.get_legend().get_texts()] == [
        n.replace("\x1b", " ") for n in NAMES
    ]
    assert any(
        "math" in t.get_text() for t in ax.get_yticklabels()
    )  # powers of ten are still set as such
    page = render_page(
        NAMES[3], [Section(name, text=name, table=pd.DataFrame({name: [name]})) for name in NAMES]
    )
    assert "<script>alert" not in page
    assert "\x1b" not in page
    assert "a_b$^\\&".translate(TEX) == r"a\_b\$\textasciicircum{}\textbackslash{}\&"


def test_an_output_that_cannot_be_is_told(
    world: dict[str, Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = ("sensor", "new", "--tau-s", "1+-0.1", "--column", "T1", "-q", "--out")
    (tmp_path / "file").write_text("no folder", encoding="utf-8")
    assert "cannot be written" in one_sentence(capsys, *words, tmp_path / "file" / "o.json")
    assert "device" in one_sentence(capsys, *words, "/dev/full")
    assert "is a folder" in one_sentence(capsys, *words, tmp_path)
    link = tmp_path / "link.json"
    link.symlink_to(tmp_path / "new" / "real.json")  # leads nowhere yet
    assert tcdyn(*words, link) == 0
    assert link.is_symlink()
    assert (
        json.loads((tmp_path / "new" / "real.json").read_text(encoding="utf-8"))["sensor"] == "link"
    )
    assert sorted(p.name for p in tmp_path.iterdir()) == ["file", "link.json", "new"]
