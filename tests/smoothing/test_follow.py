"""A growing log followed: the rows of a run with the same delay over the finished log, whatever is
wrong with a row."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from io import StringIO
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from tcdyn.chain import Chain
from tcdyn.core.errors import InputError
from tcdyn.io.read import open_table
from tcdyn.rig.rigfile import load_rig
from tcdyn.sensors import sensor_file
from tcdyn.workflows.compensate_table import compensate_table
from tcdyn.workflows.follow import FollowRun, follow
from tests.conftest import Campaign

DELAY_S = 4.0
SHORT_S = (322.0, 338.0)  # load, then the unloading at 330 s


@pytest.fixture(scope="module")
def text(campaign: Campaign) -> str:
    """The log around the unloading, as text."""
    lines = campaign.files.ehl["B3"].read_text(encoding="utf-8").splitlines(keepends=True)
    return "".join(
        lines[:1] + [x for x in lines[1:] if SHORT_S[0] <= float(x.split(",")[0]) < SHORT_S[1]]
    )


@pytest.fixture(scope="module")
def reference(
    campaign: Campaign, text: str, tmp_path_factory: pytest.TempPathFactory
) -> pd.DataFrame:
    """The rows of ``compensate`` with the same delay."""
    folder = tmp_path_factory.mktemp("reference")
    log = folder / "EHL_B3.csv"
    log.write_text(text, encoding="utf-8")
    done = compensate_table(
        log, campaign.records, folder / "out.csv", rig=campaign.rig, delay_s=DELAY_S
    )
    return read(done.path)


def read(path: Path) -> pd.DataFrame:
    return pd.read_csv(path)


def grown(
    campaign: Campaign, folder: Path, text: str, cuts: list[int], **options: object
) -> tuple[FollowRun, pd.DataFrame]:
    """Follow a file to which the parts between ``cuts`` (bytes) are appended one at each pause."""
    log = folder / "EHL_B3.csv"
    out = folder / "live.csv"
    parts = [text[a:b] for a, b in zip([0, *cuts], [*cuts, len(text)])]
    with log.open("w", encoding="utf-8", newline="") as logger:

        def pause(_: float) -> None:
            if parts:
                logger.write(parts.pop(0))
                logger.flush()
            if out.exists():  # whole lines only, at any moment
                assert not out.stat().st_size or out.read_bytes().endswith(b"\n")

        arguments: dict[str, object] = {"rig": campaign.rig, "delay_s": DELAY_S, "idle_s": 0.05}
        run = follow(log, campaign.records, out, sleep=pause, **{**arguments, **options})  # type: ignore[arg-type]
    return run, read(out)


@pytest.mark.long
@pytest.mark.e2e
def test_a_growing_log_of_the_rig_gives_the_rows_of_the_finished_one(
    campaign: Campaign, tmp_path: Path, text: str, reference: pd.DataFrame
) -> None:
    cuts = sorted(np.random.default_rng(1).integers(1, len(text), 40).tolist())  # within lines, too
    run, done = grown(campaign, tmp_path, text, cuts)
    assert run.rows_written == len(done) == len(reference)
    pd.testing.assert_frame_equal(done, reference, rtol=0, atol=0)
    assert done["time_s"].tolist() == read(tmp_path / "EHL_B3.csv")["time_s"].tolist()
    assert np.isfinite(done).all(axis=None)


@pytest.mark.e2e
def test_the_unloading_is_followed_within_its_uncertainty(
    campaign: Campaign, reference: pd.DataFrame, text: str
) -> None:
    """Error of the readings over that of the results in the five seconds after: above 6."""
    true = pd.read_parquet(campaign.files.folder / "truth" / "EHL_B3_traces.parquet")
    raw = pd.read_csv(StringIO(text))
    after = ((reference["time_s"] >= 330) & (reference["time_s"] < 335)).to_numpy()
    truth = np.interp(reference["time_s"], true["time_s"], true["fast_e_degC"])
    error = reference["fast_e_degC"].to_numpy() - truth
    logged = raw["fast_e_degC"].to_numpy() - truth
    assert np.sqrt(np.mean(error[after] ** 2)) < np.sqrt(np.mean(logged[after] ** 2)) / 6
    z = error / reference["fast_e_u_K"].to_numpy()
    assert np.mean(np.abs(z) < 1.96) > 0.9


@pytest.mark.long
@pytest.mark.e2e
def test_columns_by_other_names_decimal_commas_and_notes_above(
    campaign: Campaign, tmp_path: Path, text: str, reference: pd.DataFrame
) -> None:
    toml = campaign.files.rig.read_text(encoding="utf-8")
    table = '\n[columns]\nfast_e_degC = "TC7"\n'
    mapped = tmp_path / "rig.toml"
    mapped.write_text(
        toml.replace("[columns]\n", table) if "[columns]" in toml else toml + table,
        encoding="utf-8",
    )
    other = text.replace("fast_e_degC", "TC7").replace(",", ";").replace(".", ",")
    other = "# operator: someone\n" + other.replace("\n", "\r\n")
    _, done = grown(campaign, tmp_path, other, [], rig=load_rig(mapped))
    pd.testing.assert_frame_equal(done, reference, rtol=0, atol=0)
    assert open_table(tmp_path / "live.csv").metadata["operator"] == "someone"
    with pytest.raises(InputError, match="compensated already"):
        follow(
            tmp_path / "live.csv",
            campaign.records,
            tmp_path / "twice.csv",
            campaign.rig,
            idle_s=0.01,
            poll_s=0.02,
        )
    assert not (tmp_path / "twice.csv").exists()


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda t: "", "no two rows"),
        (lambda t: t.replace("friction_N", "force"), "friction_N"),
        (lambda t: t.replace("fast_e_degC", "x"), "fast_e_degC"),
    ],
    ids=["empty", "column missing", "junction missing"],
)
def test_a_log_that_cannot_be_followed_is_refused_and_nothing_written(
    campaign: Campaign, tmp_path: Path, text: str, change: Callable[[str], str], words: str
) -> None:
    log = tmp_path / "log.csv"
    log.write_text(change(text), encoding="utf-8")
    with pytest.raises(InputError, match=words):
        follow(log, campaign.records, tmp_path / "out.csv", campaign.rig, idle_s=0.02, poll_s=0.01)
    assert not (tmp_path / "out.csv").exists()


@pytest.mark.long
@pytest.mark.e2e
def test_a_plunge_is_followed_with_one_record(campaign: Campaign, tmp_path: Path) -> None:
    log = campaign.files.plunges["fast"][0]
    out = tmp_path / "plunge.csv"
    record = {"fast": campaign.records["fast"]}
    follow(log, record, out, campaign.rig, delay_s=DELAY_S, idle_s=0.01, poll_s=0.02)
    done = read(out)
    truth = next((campaign.files.folder / "truth").glob(f"{log.stem}*.parquet"))
    true = pd.read_parquet(truth).iloc[: len(done)]
    raw = read(log).iloc[: len(done)]
    ours, logged = (np.sqrt(np.mean((f["e_degC"] - true["e_degC"]) ** 2)) for f in (done, raw))
    assert ours < logged / 2


# Tables of two columns, at rest: quick to smooth.
SENSORS = [
    sensor_file(f"probe {k}", {f"T{k}": Chain(0.5)}, "stated", [[0.02**2]], [0.0]) for k in (1, 2)
]


def table(rows: int = 200) -> pd.DataFrame:
    rng = np.random.default_rng(0)
    columns = {f"T{k}_degC": 20.0 * k + 0.1 * rng.standard_normal(rows) for k in (1, 2)}
    return pd.DataFrame({"time_s": np.round(np.arange(rows) * 0.1, 3), **columns}).round(4)


def followed(
    folder: Path, text: str, delay_s: float = DELAY_S, **options: object
) -> tuple[FollowRun, pd.DataFrame]:
    (folder / "log.csv").write_text(text, encoding="utf-8")
    arguments: dict[str, object] = {"delay_s": delay_s, "idle_s": 0.0, "sleep": lambda _: None}
    run = follow(folder / "log.csv", SENSORS, folder / "out.csv", **{**arguments, **options})  # type: ignore[arg-type]
    return run, read(folder / "out.csv")


@pytest.mark.e2e
def test_lines_that_are_torn_blank_or_not_numbers_stay_local(tmp_path: Path) -> None:
    frame = table()
    _, whole = followed(tmp_path, frame.to_csv(index=False))
    lines = frame.to_csv(index=False).splitlines(keepends=True)
    cells = lines[100].split(",")
    lines[100] = f"{cells[0]},NaN,{cells[2]}"
    lines[120] = lines[120].replace(",", ",error,", 1)
    lines[130] = "\n" + lines[130]
    lines[140] = lines[140][:8] + "\n"
    word = lines[150].split(",")
    lines[150] = f"{word[0]},overload,{word[2]}"
    run, done = followed(tmp_path, "".join(lines), overwrite=True)
    assert run.bad_lines == 2
    torn = {round(119 * 0.1, 3), round(139 * 0.1, 3)}
    assert set(whole["time_s"]) - set(done["time_s"]) == torn
    assert np.isfinite(done.drop(columns=["T1_logged_degC", "T2_logged_degC"])).all(axis=None)
    assert set(done["time_s"][done["T1_logged_degC"].isna()]) == {9.9, 14.9}
    both = whole.set_index("time_s").loc[done["time_s"]]
    z = np.abs(done["T1_degC"].to_numpy() - both["T1_degC"].to_numpy()) / both["T1_u_K"].to_numpy()
    assert z.max() < 3.0  # noise-sized, in the samples beside a gap
    assert {f.code for f in run.findings} == {"follow.torn", "series.lost", "text.error_word"}


def test_a_channel_that_falls_silent_is_empty_and_a_wide_band_before(tmp_path: Path) -> None:
    frame = table(500)
    frame.loc[100:, "T2_degC"] = np.nan
    run, done = followed(tmp_path, frame.to_csv(index=False))
    assert done["T1_degC"].notna().all()
    u = done["T2_u_K"]
    assert np.isfinite(u[:100]).all()
    silent = u[101:].to_numpy()
    assert np.all(np.isnan(silent) | (silent > u[50]))
    assert run.rows_written == 500


@pytest.mark.e2e
@pytest.mark.parametrize("shares", [(0.4, 0.7, 1.0), (0.02, 1.0)])
def test_stopped_and_continued_no_row_is_lost_or_doubled(
    tmp_path: Path, shares: tuple[float, ...]
) -> None:
    """The output is that of one run, byte for byte; what a killed run wrote after its state is cut
    off."""
    text = table().to_csv(index=False)
    for share in shares:
        part = text[: int(share * len(text))]
        if (tmp_path / "out.csv").exists():
            with (tmp_path / "out.csv").open("a", encoding="utf-8") as stream:
                stream.write("330.0,1,2")
        run, _ = followed(tmp_path, part, state=tmp_path / "state.json")
    continued = (tmp_path / "out.csv").read_bytes()
    assert run.rows_written == 200
    once = tmp_path / "once"
    once.mkdir()
    followed(once, text)
    assert continued == (once / "out.csv").read_bytes()


def test_a_column_of_text_stays_one_whatever_comes_later_also_in_a_continued_run(
    tmp_path: Path,
) -> None:
    """Words in the first rows, numbers in all later ones: decided by the rows at the opening."""
    frame = table(120).assign(note=["warm up"] * 20 + ["7.50"] * 100)
    text = frame.to_csv(index=False)
    cut = text.index("7.50") + len("7.50\n")
    followed(tmp_path, text[:cut], state=tmp_path / "state.json")
    followed(tmp_path, text, state=tmp_path / "state.json")
    once = tmp_path / "once"
    once.mkdir()

    def grow(_: float) -> None:
        (once / "log.csv").write_text(text, encoding="utf-8")

    run, _ = followed(once, text[:cut], idle_s=0.05, sleep=grow)
    assert run.rows_written == 120
    written = pd.read_csv(once / "out.csv", dtype=str)
    assert written["note"].tolist() == frame["note"].tolist()
    assert (tmp_path / "out.csv").read_bytes() == (once / "out.csv").read_bytes()


def test_a_state_of_other_files_or_settings_is_refused(tmp_path: Path) -> None:
    text = table().to_csv(index=False)
    state: Mapping[str, object] = {"state": tmp_path / "state.json"}
    followed(tmp_path, text, **state)
    before = (tmp_path / "out.csv").read_bytes()
    with pytest.raises(InputError, match="another delay_s"):
        followed(tmp_path, text, delay_s=1.0, **state)
    with pytest.raises(InputError, match="another records"):
        follow(tmp_path / "log.csv", SENSORS[:1], tmp_path / "out.csv", delay_s=DELAY_S, **state)  # type: ignore[arg-type]
    with pytest.raises(InputError, match="not the log"):
        followed(tmp_path, text.replace("0.1,", "0.11,", 1), **state)
    assert (tmp_path / "out.csv").read_bytes() == before
    (tmp_path / "log.csv").write_text(text, encoding="utf-8")
    kept = json.loads((tmp_path / "state.json").read_text(encoding="utf-8"))
    assert kept["channels"] == ["T1_degC", "T2_degC"]
    (tmp_path / "state.json").write_text("{", encoding="utf-8")
    with pytest.raises(InputError, match="not readable as JSON"):
        followed(tmp_path, text, **state)


def test_without_a_delay_two_lags_are_taken_and_at_least_two_seconds(tmp_path: Path) -> None:
    text = table(150).to_csv(index=False)
    announced: list[float] = []
    followed(tmp_path, text, delay_s=None, announce=lambda _, delay_s: announced.append(delay_s))  # type: ignore[arg-type]
    assert announced == [2.0]
    slow = [sensor_file("slow", {"T1": Chain(3.0)}, "stated", [[0.1**2]], [0.0])]
    run = follow(tmp_path / "log.csv", slow, tmp_path / "slow.csv", idle_s=0.0, poll_s=0.01)
    assert run.delay_s == 6.0


@pytest.mark.parametrize("delay_s", [-0.1, float("nan"), 2e7])
def test_a_delay_that_cannot_be_is_refused(tmp_path: Path, delay_s: float) -> None:
    with pytest.raises(InputError, match="delay_s"):
        followed(tmp_path, table(20).to_csv(index=False), delay_s=delay_s)
    assert not (tmp_path / "out.csv").exists()
