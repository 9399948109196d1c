"""Files that earlier versions wrote are read, with the numbers that they state.

The files and the commands that made them: ``tests/stored/files/README.md``. A file of another
schema, or a damaged one, is refused in one line that says what it is and what to do.
"""

from __future__ import annotations

import gzip
import json
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tcdyn.core.errors import InputError
from tcdyn.core.estimate import Estimate
from tcdyn.core.findings import Severity
from tcdyn.identification import read_identified
from tcdyn.io.checksum import CHECKSUM_KEY, checksum, matches_checksum
from tcdyn.io.stored import BETA, CAMPAIGN, DISK, IDENTIFIED, KINDS, SENSOR, STATE, StoredKind
from tcdyn.rig.record import DiskRecord, read_record
from tcdyn.rig.rigfile import Rig, load_rig
from tcdyn.sensors import SensorFile, read_sensor, specified_sensor
from tcdyn.workflows.campaign import CampaignRun, run_campaign
from tcdyn.workflows.follow import follow

FILES = Path(__file__).parent / "files"
PAGE = Path(__file__).parents[2] / "docs" / "files.md"
VERSIONS = ("0.2", "0.3-90735cd6")
DISKS = ("fast", "slow")
TESTS = ("EHL_B3", "EHL_D4")
METHODS = ("stated", "plunge", "pair", "current", "noise")
MODELS = ("identify", "two", "chain", "response")
MAX_BYTES = 100_000

by_version = pytest.mark.parametrize("version", VERSIONS)


def stated(version: str, name: str) -> dict[str, Any]:
    """What a stored file states."""
    path = FILES / version / name
    data = gzip.decompress(path.read_bytes()) if path.suffix == ".gz" else path.read_bytes()
    content: dict[str, Any] = json.loads(data)
    return content


def unpacked(version: str, name: str, folder: Path) -> Path:
    """A compressed file as it was written, in ``folder``."""
    path = folder / name
    path.write_bytes(gzip.decompress((FILES / version / f"{name}.gz").read_bytes()))
    return path


def rig_and_records(version: str) -> tuple[Rig, dict[str, DiskRecord]]:
    """Rig and records of the campaign of a version."""
    folder = FILES / version
    records = {disk: read_record(folder / f"{disk}.disk.json") for disk in DISKS}
    return load_rig(folder / "rig.toml"), records


def same(estimate: Estimate, content: Mapping[str, float]) -> bool:
    """Whether value, uncertainty and interval are those of a file."""
    return estimate.model_dump() == dict(content)


@by_version
def test_the_folder_holds_small_files_of_each_kind_and_no_others(version: str) -> None:
    names = {path.name for path in (FILES / version).iterdir()}
    expected = {f"{disk}.disk.json" for disk in DISKS}
    expected |= {f"{method}.sensor.json" for method in METHODS}
    expected |= {f"{model}.identified.json" for model in MODELS}
    expected |= {f"{test}.beta.json.gz" for test in (*TESTS, "alone")}
    expected |= {"campaign.json", "follow.state.json", "rig.toml"}
    assert names == expected
    assert all(path.stat().st_size < MAX_BYTES for path in (FILES / version).iterdir())


@by_version
@pytest.mark.parametrize("disk", DISKS)
def test_a_disk_record_is_read_with_its_numbers(version: str, disk: str) -> None:
    name = f"{disk}.disk.json"
    content = stated(version, name)
    record = read_record(FILES / version / name)
    assert (record.disk, record.created) == (disk, content["created"])
    assert record.setup.model_dump(mode="json").items() >= {"fit": content["setup"]["fit"]}.items()
    for channel, line in content["static"].items():
        read_line = record.static[channel]
        assert (read_line.gain, read_line.offset) == (line["gain"], line["offset"])
        assert np.array_equal(read_line.covariance, line["covariance"])
    assert record.chain is not None
    assert record.chain.structure == content["chain"]["structure"]
    assert record.chain.covariance == content["chain"]["covariance"]
    assert same(record.chain.common_lag_s, content["chain"]["common_lag_s"])
    assert set(record.chain.channels) == set(content["chain"]["channels"])
    for channel, chain in content["chain"]["channels"].items():
        read_chain = record.chain.channels[channel]
        assert list(read_chain.taus_s) == chain["taus_s"]
        assert same(read_chain.lag_s, chain["lag_s"])
    assert record.conditioning.cutoff_Hz == content["conditioning"]["cutoff_Hz"]
    assert record.conditioning.poles == content["conditioning"]["poles"]
    assert [f.sentence for f in record.findings] == content["warnings"]
    grades = {"note": "info", "look": "warning", "refuse": "error"}
    expected = [grades.get(f["grade"], f["grade"]) for f in content["findings"]]
    assert [f.severity for f in record.findings] == [Severity(grade) for grade in expected]


@by_version
@pytest.mark.parametrize("method", METHODS)
def test_a_sensor_file_is_read_with_its_numbers(version: str, method: str) -> None:
    name = f"{method}.sensor.json"
    content = stated(version, name)
    sensor = read_sensor(FILES / version / name)
    assert (sensor.sensor, sensor.method) == (content["sensor"], method)
    assert sensor.columns == content["columns"]
    assert np.array_equal(sensor.lag_covariance_s2, content["chain"]["covariance"])
    for column, stated_chain, chain in zip(
        sensor.columns, content["chain"]["channels"].values(), sensor.chains
    ):
        assert list(chain.taus_s) == stated_chain["taus_s"]
        assert chain.delay_s == stated_chain["delay_s"]
        assert chain.conditioning.cutoff_Hz == content["conditioning"]["cutoff_Hz"]
        assert same(sensor.chain.channels[column].lag_s, stated_chain["lag_s"])
        for key, time in content["times"][column].items():
            assert same(sensor.times[column][key], time)
    assert sensor.fit == content["fit"]
    assert list(sensor.warnings) == content["warnings"]


@by_version
@pytest.mark.parametrize("model", MODELS)
def test_an_identified_model_is_read_with_its_numbers(version: str, model: str) -> None:
    name = f"{model}.identified.json"
    content = stated(version, name)
    read_model = read_identified(FILES / version / name)
    assert read_model.model.name == content["model"]["name"]
    assert read_model.theta == content["theta"]
    assert np.array_equal(read_model.covariance, content["covariance"])
    for parameter, estimate in content["estimates"].items():
        assert same(read_model.estimates[parameter], estimate)
    assert read_model.offset == content["offset"]
    assert read_model.noise_sd == content["noise_sd"]
    assert read_model.output_name == content["output"]["name"]
    if model == "two":
        lags = {column: part.lag_s.value for column, part in read_model.by_input.items()}
        stated_lags = {column: lag["value"] for column, lag in content["lag_s"].items()}
        assert lags == pytest.approx(stated_lags, rel=1e-12)  # rounding of a sum
    else:
        assert read_model.lag_s.value == pytest.approx(content["lag_s"]["value"], rel=1e-12)
    assert [f.sentence for f in read_model.findings] == content["warnings"]


@by_version
def test_a_model_with_a_filter_is_read_as_a_sensor(version: str) -> None:
    content = stated(version, "chain.identified.json")
    (chain,) = read_sensor(FILES / version / "chain.identified.json").chains
    assert list(chain.taus_s) == [content["theta"]["Tp1"]]
    assert chain.delay_s == content["theta"]["Td"]
    assert (chain.conditioning.cutoff_Hz, chain.conditioning.poles) == (pytest.approx(2.0), 2)


@pytest.fixture(scope="module", params=VERSIONS)
def campaign(
    request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory
) -> tuple[str, CampaignRun]:
    """The campaign of the stored results of a version, and the version."""
    version: str = request.param
    folder = tmp_path_factory.mktemp("campaign")
    results = [unpacked(version, f"{test}.beta.json", folder) for test in TESTS]
    return version, run_campaign(results, *rig_and_records(version), folder / "out")


def test_results_of_tests_are_read_with_their_numbers(campaign: tuple[str, CampaignRun]) -> None:
    version, run = campaign
    table = run.to_frame()
    statuses = {"sound": "sound", "look": "warning", "warning": "warning"}
    for test in TESTS:
        content = stated(version, f"{test}.beta.json.gz")
        row = table.loc[test]
        assert row["beta"] == content["steady"]["beta"]["value"]
        assert row["u_beta"] == content["steady"]["beta"]["u"]
        assert row["beta_both"] == content["joint"]["both"]["beta"]["value"]
        assert row["load_N"] == content["test"]["load_N"]
        assert row["fast_bulk_degC"] == content["campaign"]["bulk_degC"]["fast"]
        assert row["status"] == statuses[content["status"]]
        assert row["error"] == ""


def test_the_campaign_of_stored_results_is_the_stored_campaign(
    campaign: tuple[str, CampaignRun],
) -> None:
    """``campaign.json`` of that version, solved again: 1e-6 of u allows for eight stored digits."""
    version, run = campaign
    content = stated(version, "campaign.json")
    now = json.loads((run.folder / "campaign.json").read_text(encoding="utf-8"))
    assert now["order"] == content["order"]
    assert now["covariance"] == pytest.approx(np.array(content["covariance"]), rel=1e-6)
    for test in TESTS:
        for key in ("beta", "beta_within", "h_fast", "h_slow", "lag_fast_s", "beta_alone"):
            tolerance = 1e-6 * content["tests"][test][key]["u"]
            expected = pytest.approx(content["tests"][test][key], abs=tolerance)
            assert now["tests"][test][key] == expected
    assert now["exponent"] == pytest.approx(content["exponent"], rel=1e-6)
    assert now.keys() == content.keys()


def test_only_results_of_0_2_have_a_finding_that_says_so(
    campaign: tuple[str, CampaignRun],
) -> None:
    version, run = campaign
    texts = " ".join(finding.sentence for finding in run.findings)
    assert ("version 0.2 analysed this test" in texts) == (version == "0.2")
    assert ("uncertainty.steel_of_one_disk_rel" in texts) == (version == "0.2")


@by_version
def test_the_result_of_one_test_is_read(version: str, tmp_path: Path) -> None:
    run = run_campaign(
        [unpacked(version, "alone.beta.json", tmp_path)],
        *rig_and_records(version),
        tmp_path / "out",
    )
    content = stated(version, "alone.beta.json.gz")
    assert run.joined is not None
    assert same(run.joined.single_beta["alone"], content["joint"]["both"]["beta"])
    assert run.joined.posterior.test_names == ("alone",)


def test_results_of_two_versions_are_not_solved_together(tmp_path: Path) -> None:
    """Their models differ: the steel of one disk has an uncertainty only in 0.3."""
    old = unpacked("0.2", "EHL_B3.beta.json", tmp_path)
    new = unpacked("0.3-90735cd6", "EHL_D4.beta.json", tmp_path)
    with pytest.raises(InputError, match=r"analysed with another rig\.toml or other records"):
        run_campaign([old, new], *rig_and_records("0.2"), tmp_path / "out")


@pytest.mark.parametrize("version", VERSIONS)
def test_the_state_of_a_followed_log_of_another_schema_is_refused(
    version: str, tmp_path: Path
) -> None:
    log = tmp_path / "run.csv"
    log.write_text("time_s,T1_degC\n" + "".join(f"{k},{20 + k}\n" for k in range(30)))
    out = tmp_path / "live.csv"
    out.write_text("time_s,T1_degC,T1_u_K\n0,20,0.1\n")
    before = out.read_bytes()
    content = (FILES / version / "follow.state.json").read_bytes()
    state = tmp_path / "follow.state.json"
    state.write_bytes(content)
    probe = specified_sensor("probe", ["T1"], [(1.5, 0.1)])
    with pytest.raises(InputError) as problem:
        follow(log, [probe], out, state=state, idle_s=0.0, poll_s=0.01)
    message = str(problem.value)
    schema = json.loads(content)["schema"]
    assert f"{state}: is the state of a followed log of schema {schema}" in message
    assert "which an earlier version of tcdyn wrote" in message
    assert f"expected the state of a followed log of schema {STATE.schema}" in message
    assert "continue the run with the version of tcdyn that wrote it" in message
    assert f"delete {state} and give another out=FILE" in message
    assert "\n" not in message
    assert (out.read_bytes(), state.read_bytes()) == (before, content)


def read_state(path: Path) -> None:
    """Continue a run of a log beside the state file."""
    log = path.parent / "log.csv"
    log.write_text("time_s,T1_degC\n" + "".join(f"{k},{20 + k}\n" for k in range(30)))
    probe = specified_sensor("probe", ["T1"], [(1.5, 0.1)])
    follow(log, [probe], path.parent / "o.csv", state=path, idle_s=0.0, poll_s=0.01)


def read_beta(path: Path) -> None:
    """Use the file as the result of a test."""
    run_campaign([path], *rig_and_records("0.3-90735cd6"), path.parent / "out")


READERS: dict[str, tuple[StoredKind, str, Callable[[Path], object]]] = {
    "disk": (DISK, "fast.disk.json", read_record),
    "sensor": (SENSOR, "plunge.sensor.json", read_sensor),
    "identified": (IDENTIFIED, "chain.identified.json", read_identified),
    "identified as sensor": (IDENTIFIED, "chain.identified.json", read_sensor),
    "beta": (BETA, "EHL_B3.beta.json", read_beta),
    "state": (STATE, "follow.state.json", read_state),
}
by_reader = pytest.mark.parametrize("reader", READERS)


def refusal(reader: str, text: str, folder: Path) -> str:
    """The one-line message with which a reader refuses a file with this text."""
    _, name, read = READERS[reader]
    path = folder / name
    path.write_text(text, encoding="utf-8")
    with pytest.raises(InputError) as problem:
        read(path)
    message = str(problem.value)
    assert message.startswith(f"{path}: ")
    assert "\n" not in message
    return message


def current(reader: str) -> dict[str, Any]:
    """Content of a file with the schema that this version writes."""
    kind, name, _ = READERS[reader]
    content = stated("0.3-90735cd6", f"{name}.gz" if kind is BETA else name)
    return {**content, "schema": kind.schema}


@by_reader
def test_a_file_of_a_later_schema_is_refused_with_its_kind_and_a_remedy(
    reader: str, tmp_path: Path
) -> None:
    kind = READERS[reader][0]
    later = f"{kind.name}/{kind.numbers[-1] + 1}"
    message = refusal(reader, json.dumps({**current(reader), "schema": later}), tmp_path)
    assert f"is {kind.text} of schema {later}, which a later version of tcdyn wrote" in message
    assert kind.expected in message
    assert "update tcdyn" in message


@by_reader
def test_a_file_of_another_kind_is_refused_with_its_kind(reader: str, tmp_path: Path) -> None:
    kind = READERS[reader][0]
    message = refusal(reader, json.dumps({"schema": CAMPAIGN.schema}), tmp_path)
    assert f"is {CAMPAIGN.text} of schema {CAMPAIGN.schema}" in message
    assert kind.expected in message
    assert " that `tcdyn " in message


@by_reader
@pytest.mark.parametrize("text", ["", "{", "[1, 2]", "null", "{}", '{"schema": "mine"}'])
def test_a_file_without_a_schema_is_refused(reader: str, text: str, tmp_path: Path) -> None:
    message = refusal(reader, text, tmp_path)
    assert "; expected " in message
    assert " that `tcdyn " in message


@by_reader
def test_a_file_cut_off_is_refused(reader: str, tmp_path: Path) -> None:
    text = json.dumps(current(reader))
    message = refusal(reader, text[: len(text) // 2], tmp_path)
    assert "not readable as JSON" in message


@by_reader
def test_a_file_without_one_of_its_keys_is_refused_or_has_a_finding(
    reader: str, tmp_path: Path
) -> None:
    """Each key is left out in turn; no other exception may come."""
    kind, name, read = READERS[reader]
    content = current(reader)
    if CHECKSUM_KEY in content:
        content[CHECKSUM_KEY] = checksum({k: v for k, v in content.items() if k != CHECKSUM_KEY})
        assert matches_checksum(content)
    path = tmp_path / name
    for key in content:
        path.write_text(json.dumps({k: v for k, v in content.items() if k != key}))
        message = ""
        result = None
        try:
            result = read(path)
        except InputError as problem:
            message = str(problem)
        if message:
            assert message.startswith(f"{path}: ")
            assert "; " in message
        else:
            assert kind in (DISK, SENSOR, IDENTIFIED)
        if isinstance(result, DiskRecord | SensorFile) and key != CHECKSUM_KEY:
            codes = [finding.code for finding in result.findings]
            assert ("file.altered" in codes) == (CHECKSUM_KEY in content)


def test_each_kind_has_a_name_and_the_schema_that_is_written() -> None:
    assert len({kind.name for kind in KINDS}) == len(KINDS)
    assert DiskRecord.model_fields["schema_"].default == DISK.schema
    assert SensorFile.model_fields["schema_"].default == SENSOR.schema


@pytest.mark.parametrize("kind", KINDS, ids=lambda kind: kind.name)
def test_the_manual_names_the_schemas_of_each_kind(kind: StoredKind) -> None:
    section = PAGE.read_text(encoding="utf-8").split("## Files of earlier versions")[1]
    (row,) = [line for line in section.splitlines() if f"`{kind.name}/" in line]
    _, _, written, read, versions, _ = (cell.strip() for cell in row.split("|"))
    assert written == f"`{kind.schema}`"
    if kind is CAMPAIGN:
        assert read == "no command reads it"
    else:
        assert read.split() == [f"`{kind.name}/{number}`" for number in kind.numbers]
    assert versions
